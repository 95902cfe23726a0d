/* Models of how a value moves, with constant gains, mixed by their likelihood: averages and trends side by side. */
#ifndef SKIN_MODELS_H
#define SKIN_MODELS_H

#include "board.h"

/* Gains of level and slope, 1 / (2 S) and ln(S) / 2 of the innovation's variance S, variance of the forecast. */
typedef struct {
    float gain, slope_gain, half_precision, log_spread, variance;
} skin_model;

/* State of SKIN_BLOCK_SIZE values, in units of their scales; averages, which come first, have no slope. All values of a kind
 * stand together, so that compilers find vectors.
 */
typedef struct {
    float level[SKIN_MODELS][SKIN_BLOCK_SIZE], slope[SKIN_MODELS - SKIN_AVERAGE_COUNT][SKIN_BLOCK_SIZE];
    float weight[SKIN_MODELS][SKIN_BLOCK_SIZE];
} skin_tracks;

static inline float skin_smaller(float one, float other)
{
    return one < other ? one : other;
}

static inline float skin_larger(float one, float other)
{
    return one > other ? one : other;
}

/* Begin the track of one value, all models alike. */
void skin_begin_track(skin_tracks *tracks, uint16_t place, float level);

/* Take one sample of every value; write forecasts SKIN_HORIZON samples ahead, and their variances. */
void skin_step(skin_tracks *tracks, const float *sample, float *forecast, float *variance);

#endif
