#include "skin_models.h"

#if SKIN_ADAPTIVE || SKIN_SAMPLES > 1 /* boards that sample at the SYNC only need no models */

#include <string.h>

static const skin_model models[SKIN_MODELS] = SKIN_MODEL_ROWS;
/* Polynomial of 2^f for f from 0 to 1. */
static const float power[] = SKIN_POWER;

static float least_of(float one, float other)
{
    return one < other ? one : other;
}

static float most_of(float one, float other)
{
    return one > other ? one : other;
}

void skin_begin_track(skin_tracks *tracks, uint16_t place, float level)
{
    uint8_t model;

    for (model = 0; model < SKIN_MODELS; model++) {
        tracks->level[model][place] = level;
        tracks->weight[model][place] = 1.0f / SKIN_MODELS;
    }
    for (model = 0; model < SKIN_MODELS - SKIN_AVERAGE_COUNT; model++) {
        tracks->slope[model][place] = 0;
    }
}

/* Mix, predict and update all models; write how surprised each is. */
static void update(skin_tracks *tracks, const float *sample, float surprise[][SKIN_BLOCK_SIZE])
{
    const float change = SKIN_CHANGE, keep = SKIN_STAY - SKIN_CHANGE;
    float level_mean[SKIN_BLOCK_SIZE] = {0}, slope_mean[SKIN_BLOCK_SIZE] = {0};
    uint16_t c;
    uint8_t model;

    for (model = 0; model < SKIN_MODELS; model++) {
        const float *level = tracks->level[model], *weight = tracks->weight[model];

        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            level_mean[c] += weight[c] * level[c];
        }
        if (model >= SKIN_AVERAGE_COUNT) {
            const float *slope = tracks->slope[model - SKIN_AVERAGE_COUNT];

            for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
                slope_mean[c] += weight[c] * slope[c];
            }
        }
    }
    for (model = 0; model < SKIN_MODELS; model++) {
        float *level = tracks->level[model], *weight = tracks->weight[model];
        const skin_model each = models[model];
        float mixed_slope[SKIN_BLOCK_SIZE] = {0}, kept[SKIN_BLOCK_SIZE], scale[SKIN_BLOCK_SIZE];

        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            kept[c] = keep * weight[c];
            weight[c] = change + kept[c];
            scale[c] = 1.0f / weight[c];
        }
        if (model >= SKIN_AVERAGE_COUNT) {
            const float *slope = tracks->slope[model - SKIN_AVERAGE_COUNT];

            for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
                mixed_slope[c] = (change * slope_mean[c] + kept[c] * slope[c]) * scale[c];
            }
        }
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            const float predicted = (change * level_mean[c] + kept[c] * level[c]) * scale[c] + mixed_slope[c];
            const float innovation = sample[c] - predicted;

            level[c] = predicted + each.gain * innovation;
            mixed_slope[c] += each.slope_gain * innovation;
            surprise[model][c] = innovation * innovation * each.half_precision + each.log_spread;
        }
        if (model >= SKIN_AVERAGE_COUNT) {
            memcpy(tracks->slope[model - SKIN_AVERAGE_COUNT], mixed_slope, sizeof mixed_slope);
        }
    }
}

/* Multiply the weights by the likelihoods exp(-surprise), relative to the likeliest, and make their sum 1. */
static void weigh(skin_tracks *tracks, float surprise[][SKIN_BLOCK_SIZE])
{
    float least[SKIN_BLOCK_SIZE], total[SKIN_BLOCK_SIZE] = {0}, scale[SKIN_BLOCK_SIZE];
    int32_t bits[SKIN_BLOCK_SIZE];
    uint16_t c;
    uint8_t model;

    memcpy(least, surprise[0], sizeof least);
    for (model = 1; model < SKIN_MODELS; model++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            least[c] = least_of(surprise[model][c], least[c]);
        }
    }
    for (model = 0; model < SKIN_MODELS; model++) {
        float *weight = tracks->weight[model];

        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            /* 2^x as exponent bits times a polynomial. */
            const float exponent = most_of((least[c] - surprise[model][c]) * SKIN_LOG2_E, SKIN_LEAST_EXPONENT);
            const int32_t cut = (int32_t)exponent, whole = cut - ((float)cut > exponent);
            const float f = exponent - (float)whole;
            const float high = power[2] + f * (power[3] + f * (power[4] + f * power[5]));

            bits[c] = (int32_t)((uint32_t)(whole + 127) << 23);
            scale[c] = power[0] + f * (power[1] + f * high);
        }
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            float two_to;

            memcpy(&two_to, &bits[c], sizeof two_to);
            weight[c] *= scale[c] * two_to;
            total[c] += weight[c];
        }
    }
    for (model = 0; model < SKIN_MODELS; model++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            tracks->weight[model][c] = most_of(tracks->weight[model][c] / total[c], SKIN_LEAST_WEIGHT);
        }
    }
}

void skin_step(skin_tracks *tracks, const float *sample, float *forecast, float *variance)
{
    float surprise[SKIN_MODELS][SKIN_BLOCK_SIZE];
    uint16_t c;
    uint8_t model;

    update(tracks, sample, surprise);
    weigh(tracks, surprise);
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        forecast[c] = variance[c] = 0;
    }
    for (model = 0; model < SKIN_MODELS; model++) {
        const float *level = tracks->level[model], *weight = tracks->weight[model];
        const float spread = models[model].variance;

        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            variance[c] += weight[c] * spread;
        }
        if (model < SKIN_AVERAGE_COUNT) {
            for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
                forecast[c] += weight[c] * level[c];
            }
        } else {
            const float *slope = tracks->slope[model - SKIN_AVERAGE_COUNT];

            for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
                forecast[c] += weight[c] * (level[c] + SKIN_HORIZON * slope[c]);
            }
        }
    }
}

#endif
