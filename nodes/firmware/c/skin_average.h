/* From what the converters of a board read to the sums of a block, with the average of a taxel's samples between two SYNCs, as
 * far as motion allows ("What a sum is a sum of" in docs/bus.md).
 *
 * The models of skin_models.h run on every sample; their mean, weighted by likelihood, is the average. Noise that the
 * sensor clips at 0 is learned from taxels that nothing touches, and its bias is undone. Needs a floating point unit:
 * about 150 operations for each taxel and sample.
 */
#ifndef SKIN_AVERAGE_H
#define SKIN_AVERAGE_H

#include <stddef.h>

#include "board.h"
#include "skin_models.h"
#include "skin_sums.h"

/* What one converter reads, and the number of converters of a board: a code of each sum, in two's complement and in the order
 * of 2003h, block after block, or a count of each taxel in the order of the chains (2004h).
 */
#if SKIN_ANALOGUE
typedef int16_t skin_reading;
#define SKIN_READINGS SKIN_SUMS
#else
typedef uint16_t skin_reading;
#define SKIN_READINGS (SKIN_BLOCKS * SKIN_BLOCK_SIZE)
#endif

/* Readings of one sample of all converters of a board. */
static inline uint16_t skin_readings(const skin_board *board)
{
    const skin_type *type = board->type;

    return (uint16_t)(SKIN_ANALOGUE ? type->first_sum[type->blocks] : type->blocks * type->block_size);
}

/* Places of a block that have a gain and an offset; analogue boards have neither. */
#define SKIN_CALIBRATED (SKIN_ANALOGUE ? 1 : SKIN_BLOCK_SIZE)

/* Calibration, newest counts and test pattern of a block: 2010h, 2011h, 2012h and 2021h. */
typedef struct {
    float *gain;
    int16_t *offset;
    uint16_t *counts;
    uint8_t *pattern;
} skin_block;

/* Average of one block. */
typedef struct {
    skin_tracks tracks;                         /* in units of `scale` */
    float last[2][SKIN_BLOCK_SIZE];             /* the two newest samples, counts */
    float square[SKIN_BLOCK_SIZE], size[SKIN_BLOCK_SIZE]; /* mean square and mean size of second differences */
    float scale[SKIN_BLOCK_SIZE];                         /* deviation of each taxel's noise, counts */
    float average[SKIN_BLOCK_SIZE], variance[SKIN_BLOCK_SIZE]; /* counts; in units of the noise's */
    float noise;                                               /* deviation of the block's noise, 0 while unknown */
    uint16_t age;                                              /* samples since the beginning, limited */
} skin_average;

/* Begin anew: what the taxels have read is forgotten, and their noise. */
void skin_forget(skin_average *state);

/* Take in what the taxels of a block read since the last call, and return their averages in counts.
 *
 * samples: ADC counts, `count` samples, each of SKIN_BLOCK_SIZE values that follow `stride` values after the sample before.
 * averages: room for SKIN_BLOCK_SIZE values.
 */
void skin_take_samples(skin_average *state, const uint16_t *samples, uint16_t count, uint16_t stride, float *averages);

/* Sums of one block of board.h, SKIN_SAMPLES of 1 or more; returns the number of taxels at the top of their range, or of sums
 * at an end of it.
 *
 * state: where samples are averaged, else NULL. readings: of the board, `samples` samples; overwritten. block: its newest counts
 * are written. sums: room for the sums of the block, ADC counts.
 */
uint16_t skin_measure(const skin_board *board, uint8_t number, skin_average *state, skin_reading *readings, uint16_t samples,
                      const skin_block *block, int32_t *sums);

/* The state of a block among `states`, or NULL. */
#if SKIN_SAMPLES > 1
#define SKIN_AVERAGE_OF(states, block) (&(states)[block])
#else
#define SKIN_AVERAGE_OF(states, block) NULL
#endif

#endif
