/* Learning of the noise at power-up ("Noise" in docs/steps.md), and the Haar pyramid of a patch. */
#include <math.h>

#include "skin_filter.h"

static const uint8_t spans[SKIN_SPAN_COUNT] = SKIN_SPANS;

/* The additions stand in the order of nodes/steps/transforms.py, so that both round alike. */

void skin_to_haar(float *mean, float *coefficient)
{
    uint8_t rows = SKIN_PATCH_HIGH, columns = SKIN_PATCH_WIDE, end = SKIN_BLOCK_SUMS, row, column;

    while (rows > 1) {
        const uint8_t squares = (uint8_t)(rows * columns / 4);

        end = (uint8_t)(end - 3 * squares);
        for (row = 0; row < rows; row = (uint8_t)(row + 2)) {
            for (column = 0; column < columns; column = (uint8_t)(column + 2)) {
                const uint8_t first = (uint8_t)(row * columns + column);
                const uint8_t place = (uint8_t)(row * columns / 4 + column / 2);
                const float *above = &mean[first], *below = &mean[first + columns];
                const float top = above[0] + above[1], bottom = below[0] + below[1];
                const float upper = above[0] - above[1], lower = below[0] - below[1];

                mean[place] = (top + bottom) * 0.5f;
                coefficient[end + place] = (top - bottom) * 0.5f;
                coefficient[end + squares + place] = (upper + lower) * 0.5f;
                coefficient[end + 2 * squares + place] = (upper - lower) * 0.5f;
            }
        }
        rows = (uint8_t)(rows / 2);
        columns = (uint8_t)(columns / 2);
    }
    coefficient[0] = mean[0];
    if (columns == 2) {
        coefficient[0] = (mean[0] + mean[1]) * SKIN_ROOT_HALF;
        coefficient[1] = (mean[0] - mean[1]) * SKIN_ROOT_HALF;
    }
}

void skin_from_haar(const float *coefficient, float *mean)
{
    uint8_t rows = 1, columns = SKIN_PATCH_WIDE / SKIN_PATCH_HIGH, end = columns;
    int8_t row, column;

    mean[0] = coefficient[0];
    if (columns == 2) {
        mean[0] = (coefficient[0] + coefficient[1]) * SKIN_ROOT_HALF;
        mean[1] = (coefficient[0] - coefficient[1]) * SKIN_ROOT_HALF;
    }
    while (rows < SKIN_PATCH_HIGH) {
        const uint8_t squares = (uint8_t)(rows * columns);

        rows = (uint8_t)(2 * rows);
        columns = (uint8_t)(2 * columns);
        /* From the last square on: no value is overwritten before it is read. */
        for (row = (int8_t)(rows - 2); row >= 0; row = (int8_t)(row - 2)) {
            for (column = (int8_t)(columns - 2); column >= 0; column = (int8_t)(column - 2)) {
                const uint8_t first = (uint8_t)(row * columns + column);
                const uint8_t place = (uint8_t)(row * columns / 4 + column / 2);
                const float whole = mean[place], down = coefficient[end + place];
                const float across = coefficient[end + squares + place], both = coefficient[end + 2 * squares + place];

                mean[first] = ((whole + down) + (across + both)) * 0.5f;
                mean[first + 1] = ((whole + down) - (across + both)) * 0.5f;
                mean[first + columns] = ((whole - down) + (across - both)) * 0.5f;
                mean[first + columns + 1] = ((whole - down) - (across - both)) * 0.5f;
            }
        }
        end = (uint8_t)(end + 3 * squares);
    }
}

void skin_learn_idle(skin_idle *idle, uint16_t count, const float *sample_n)
{
    float work[SKIN_BLOCK_SUMS], coefficients[SKIN_BLOCK_SUMS];
    uint8_t c, span;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        work[c] = sample_n[c];
        idle->sum[c] += sample_n[c];
        idle->square[c] += (double)sample_n[c] * (double)sample_n[c];
    }
    skin_to_haar(work, coefficients);
    for (span = 0; span < SKIN_SPAN_COUNT; span++) {
        for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
            double *partial = &idle->partial[span][c];

            *partial += coefficients[c];
            if (count % spans[span] == 0) {
                *partial /= spans[span];
                idle->mean[span][c] += *partial;
                idle->mean_square[span][c] += *partial * *partial;
                *partial = 0;
            }
        }
    }
}

static double at_least(double value, double least)
{
    return value > least ? value : least;
}

void skin_learned_noise(skin_filter *filter)
{
    const skin_idle *idle = &filter->u.idle;
    uint8_t c, span;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        const double mean = idle->sum[c] / SKIN_IDLE_SAMPLES;
        const double deviation = sqrt(at_least(idle->square[c] / SKIN_IDLE_SAMPLES - mean * mean, 0));
        const double taxel_n = at_least(deviation / SKIN_IDLE_DEVIATION, SKIN_LEAST_NOISE_N);
        double variance = 0;

        for (span = 0; span < SKIN_SPAN_COUNT; span++) {
            const uint16_t count = SKIN_IDLE_SAMPLES / spans[span];
            const double mean_of = idle->mean[span][c] / count;

            variance = at_least(variance, spans[span] * (idle->mean_square[span][c] / count - mean_of * mean_of));
        }
        filter->idle_offset_n[c] = (float)mean;
        filter->learned_taxel_n[c] = (float)taxel_n;
        filter->learned_coefficient_n[c] =
            (float)at_least(sqrt(variance) / SKIN_IDLE_DEVIATION, SKIN_LEAST_NOISE_N);
    }
}
