#include "skin_models.h"

#if SKIN_STEPPED || SKIN_SAMPLES > 1 /* boards that sample at the SYNC only need no models */

#include <stddef.h>
#include <string.h>

static const skin_model models[SKIN_MODELS] = SKIN_MODEL_ROWS;
/* Polynomial of 2^f for f from 0 to 1. */
static const float power[] = SKIN_POWER;

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

/* Mix, predict and update one model, whose slope is NULL for an average; write how surprised it is. */
static void update(const skin_model *model, float *restrict level, float *restrict slope, float *restrict weight,
                   const float *restrict sample, const float *restrict level_mean, const float *restrict slope_mean,
                   float *restrict surprise)
{
    const float change = SKIN_CHANGE, keep = SKIN_STAY - SKIN_CHANGE;
    uint16_t c;

    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        const float kept = keep * weight[c], likely = change + kept, scale = 1.0f / likely;
        const float mixed_slope = slope == NULL ? 0 : (change * slope_mean[c] + kept * slope[c]) * scale;
        const float predicted = (change * level_mean[c] + kept * level[c]) * scale + mixed_slope;
        const float innovation = sample[c] - predicted;

        level[c] = predicted + model->gain * innovation;
        if (slope != NULL) {
            slope[c] = mixed_slope + model->slope_gain * innovation;
        }
        weight[c] = likely;
        surprise[c] = innovation * innovation * model->half_precision + model->log_spread;
    }
}

/* 2^exponent for -120 <= exponent <= 0 as exponent bits times a polynomial, error below 2e-7. */
static float power_of_two(float exponent)
{
    const int32_t cut = (int32_t)exponent, whole = cut - ((float)cut > exponent); /* rounded down */
    const float f = exponent - (float)whole;
    const uint32_t bits = (uint32_t)(whole + 127) << 23;
    float two_to;

    memcpy(&two_to, &bits, sizeof two_to);
    return (power[0] + f * (power[1] + f * (power[2] + f * (power[3] + f * (power[4] + f * power[5]))))) * two_to;
}

/* Multiply the weights by the likelihoods exp(-surprise), relative to the likeliest, and make their sum 1. */
static void weigh(skin_tracks *tracks, float surprise[][SKIN_BLOCK_SIZE])
{
    float least[SKIN_BLOCK_SIZE], total[SKIN_BLOCK_SIZE] = {0};
    uint16_t c;
    uint8_t m;

    memcpy(least, surprise[0], sizeof least);
    for (m = 1; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            least[c] = skin_smaller(surprise[m][c], least[c]);
        }
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            const float exponent = skin_larger((least[c] - surprise[m][c]) * SKIN_LOG2_E, SKIN_LEAST_EXPONENT);

            tracks->weight[m][c] *= power_of_two(exponent);
            total[c] += tracks->weight[m][c];
        }
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            tracks->weight[m][c] = skin_larger(tracks->weight[m][c] / total[c], SKIN_LEAST_WEIGHT);
        }
    }
}

void skin_step(skin_tracks *tracks, const float *sample, float *forecast, float *variance)
{
    float surprise[SKIN_MODELS][SKIN_BLOCK_SIZE], level_mean[SKIN_BLOCK_SIZE] = {0}, slope_mean[SKIN_BLOCK_SIZE] = {0};
    uint16_t c;
    uint8_t m;

    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            level_mean[c] += tracks->weight[m][c] * tracks->level[m][c];
        }
        for (c = 0; m >= SKIN_AVERAGE_COUNT && c < SKIN_BLOCK_SIZE; c++) {
            slope_mean[c] += tracks->weight[m][c] * tracks->slope[m - SKIN_AVERAGE_COUNT][c];
        }
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        update(&models[m], tracks->level[m], m < SKIN_AVERAGE_COUNT ? NULL : tracks->slope[m - SKIN_AVERAGE_COUNT],
               tracks->weight[m], sample, level_mean, slope_mean, surprise[m]);
    }
    weigh(tracks, surprise);
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        forecast[c] = variance[c] = 0;
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            const float slope = m < SKIN_AVERAGE_COUNT ? 0 : tracks->slope[m - SKIN_AVERAGE_COUNT][c];

            forecast[c] += tracks->weight[m][c] * (tracks->level[m][c] + SKIN_HORIZON * slope);
            variance[c] += tracks->weight[m][c] * models[m].variance;
        }
    }
}

#endif
