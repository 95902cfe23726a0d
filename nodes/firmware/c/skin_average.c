#include "skin_average.h"

#include <string.h>

#if SKIN_SAMPLES > 1 /* boards that sample at the SYNC only need no average */

#include <math.h>

/* Mean of x + N(0, 1) clipped at 0, for x from 0 to SKIN_CLIPPED_REACH. */
static const float clipped_mean[SKIN_CLIPPED_POINTS] = SKIN_CLIPPED_MEAN;

/* Force whose clipped mean is `mean`; both in units of the noise's deviation. */
static float unclipped(float mean)
{
    uint16_t low = 0, high = SKIN_CLIPPED_POINTS - 1;

    if (mean <= clipped_mean[0]) {
        return 0.0f;
    }
    if (mean >= clipped_mean[high]) {
        return mean;
    }
    while (high - low > 1) {
        const uint16_t middle = (uint16_t)((low + high) / 2);

        if (clipped_mean[middle] <= mean) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return SKIN_CLIPPED_REACH / (SKIN_CLIPPED_POINTS - 1) *
           ((float)low + (mean - clipped_mean[low]) / (clipped_mean[high] - clipped_mean[low]));
}

void skin_forget(skin_average *state)
{
    state->age = 0;
    state->noise = 0.0f;
}

/* Follow the mean of the squares and of the sizes of second differences. */
static void learn(skin_average *state, const float *sample)
{
    float gain = 1.0f / SKIN_MEMORY, limit = 0.0f;
    uint16_t c;

    if (state->age == 0) {
        memset(state->square, 0, sizeof state->square);
        memset(state->size, 0, sizeof state->size);
    } else if (state->age > 1) {
        gain = state->age <= SKIN_MEMORY ? 1.0f / (float)(state->age - 1) : gain;
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            float found = fabsf(sample[c] - 2.0f * state->last[0][c] + state->last[1][c]);

            if (state->age > SKIN_MEMORY) {
                limit = sqrtf(SKIN_OUTLIER_RATIO * skin_larger(state->square[c], 6.0f * SKIN_ROUNDING));
                found = skin_smaller(found, limit);
            }
            state->square[c] += gain * (found * found - state->square[c]);
            state->size[c] += gain * (found - state->size[c]);
        }
    }
    memcpy(state->last[1], state->last[0], sizeof state->last[0]);
    memcpy(state->last[0], sample, sizeof state->last[0]);
    if (state->age < 2 * SKIN_MEMORY) {
        state->age++;
    }
}

/* Deviation of a taxel's noise before clipping, which makes it smaller where nothing touches. */
static float deviation(const skin_average *state, uint16_t c)
{
    const float seen = sqrtf(skin_larger(state->square[c] / 6.0f, SKIN_ROUNDING));

    return state->noise > 0.0f ? skin_larger(state->noise, seen) : seen / (float)SKIN_IDLE_DEVIATION;
}

/* Express levels and slopes in units of the new scale, or begin them with a first sample. */
static void change_scale(skin_average *state, const float *scale, const float *first)
{
    skin_tracks *tracks = &state->tracks;
    uint16_t c;
    uint8_t m;

    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        if (first != NULL) {
            skin_begin_track(tracks, c, first[c] / scale[c]);
            continue;
        }
        for (m = 0; m < SKIN_MODELS; m++) {
            tracks->level[m][c] *= state->scale[c] / scale[c];
        }
        for (m = 0; m < SKIN_MODELS - SKIN_AVERAGE_COUNT; m++) {
            tracks->slope[m][c] *= state->scale[c] / scale[c];
        }
    }
    memcpy(state->scale, scale, sizeof state->scale);
}

/* Learn the noise of a block from the median of its idle taxels: a few noisy ones are idle, too. */
static void learn_noise(skin_average *state)
{
    float ordered[SKIN_BLOCK_SIZE], found;
    uint16_t c, count = 0, place;

    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        const float clean = skin_larger(state->square[c] / 6.0f - SKIN_ROUNDING, 0.0f);
        const float expected = sqrtf(clean) * (float)(SKIN_IDLE_MEAN / SKIN_IDLE_DEVIATION);

        if (fabsf(state->average[c] - expected) < SKIN_IDLE_BAND * expected &&
            state->size[c] * state->size[c] > SKIN_EVENNESS * state->square[c] && state->age >= SKIN_MEMORY) {
            for (place = count++; place > 0 && ordered[place - 1] > clean; place--) {
                ordered[place] = ordered[place - 1];
            }
            ordered[place] = clean;
        }
    }
    if (count == 0 || SKIN_IDLE_TAXELS * count < SKIN_BLOCK_SIZE) {
        return;
    }
    found = sqrtf((ordered[(count - 1) / 2] + ordered[count / 2]) / 2.0f) / (float)SKIN_IDLE_DEVIATION;
    state->noise = state->noise > 0.0f ? state->noise + SKIN_LEARNING_GAIN * (found - state->noise) : found;
}

/* One sample as floating point numbers. */
static void convert(const uint16_t *sample, float *made)
{
    uint16_t c;

    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        made[c] = (float)sample[c];
    }
}

void skin_take_samples(skin_average *state, const uint16_t *samples, uint16_t count, uint16_t stride, float *averages)
{
    float sample[SKIN_BLOCK_SIZE], scale[SKIN_BLOCK_SIZE];
    uint16_t c, each;

    for (each = 0; each < count; each++) {
        convert(&samples[(uint32_t)each * stride], sample);
        learn(state, sample);
    }
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        scale[c] = deviation(state, c);
    }
    convert(samples, sample);
    change_scale(state, scale, state->age <= count ? sample : NULL);
    for (each = 0; each < count; each++) {
        convert(&samples[(uint32_t)each * stride], sample);
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            sample[c] /= scale[c];
        }
        skin_step(&state->tracks, sample, state->average, state->variance);
    }
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        state->average[c] *= scale[c];
    }
    learn_noise(state);
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        float force = state->average[c];

        if (state->noise > 0.0f) {
            force = unclipped(force / state->noise) * state->noise;
            if (force < SKIN_AVERAGE_DEAD_RATIO * sqrtf(state->variance[c]) * scale[c]) {
                force = 0.0f;
            }
        }
        averages[c] = force;
    }
}

/* Return gain * average + offset, limited to 0 to `count_max`; no rounding to whole counts. */
static float correct(float average, float gain, int16_t offset, uint16_t count_max)
{
    /* Volatile: product and sum are rounded to 32 bits each, also where the processor could fuse both. */
    volatile float product = average * gain, corrected;

    corrected = product + (float)offset;
    return corrected > 0.0f ? skin_smaller(corrected, (float)count_max) : 0.0f;
}

/* The nearest whole number; halves are rounded to even. */
static int32_t nearest(float value)
{
    const int32_t whole = (int32_t)value;
    const float rest = value - (float)whole; /* exact */
    const int is_odd = (whole & 1) != 0;

    if (rest > 0.5f || (rest == 0.5f && is_odd)) {
        return whole + 1;
    }
    return rest < -0.5f || (rest == -0.5f && is_odd) ? whole - 1 : whole;
}

/* Sums of one block, rounded to whole counts, of `values`, which are overwritten; otherwise as `skin_block_sums`. */
static void block_sums(const skin_board *board, uint8_t block, float *values, int32_t *sums)
{
    const uint16_t first_sum = board->type->first_sum[block], end = board->type->first_sum[block + 1];
    uint16_t half, first, place, sum;

    for (half = 1; half < SKIN_BLOCK_SIZE; half = (uint16_t)(2 * half)) {
        for (first = 0; first < SKIN_BLOCK_SIZE; first = (uint16_t)(first + 2 * half)) {
            for (place = first; place < first + half; place++) {
                const float above = values[place], below = values[place + half];

                values[place] = above + below;
                values[place + half] = above - below;
            }
        }
    }
    for (sum = first_sum; sum < end; sum++) {
        sums[sum - first_sum] = nearest(values[SKIN_ROWS(board)[sum]]);
    }
}

#endif

#if SKIN_ANALOGUE

uint16_t skin_measure(const skin_board *board, uint8_t number, skin_average *state, skin_reading *readings, uint16_t samples,
                      const skin_block *block, int32_t *sums)
{
    const uint16_t first = board->type->first_sum[number], end = board->type->first_sum[number + 1];
    const skin_reading *newest = &readings[(uint32_t)(samples - 1) * skin_readings(board)];
    const int32_t half = ((int32_t)board->type->count_max + 1) / 2;
    uint16_t shown[SKIN_BLOCK_SIZE], sum, saturated = 0;
    int32_t work[SKIN_BLOCK_SIZE];

    (void)state;
    if (*block->pattern != SKIN_PATTERN_OFF) {
        (void)skin_read_block(board, shown, NULL, NULL, *block->pattern);
        skin_block_sums(board, number, shown, work, sums);
    }
    for (sum = first; sum < end; sum++) {
        const int32_t code = *block->pattern != SKIN_PATTERN_OFF ? skin_code(board, sums[sum - first]) : newest[sum];

        saturated = (uint16_t)(saturated + (code <= -half || code >= half - 1));
        sums[sum - first] = code * board->type->block_size;
    }
    return saturated;
}

#else

uint16_t skin_measure(const skin_board *board, uint8_t number, skin_average *state, skin_reading *readings, uint16_t samples,
                      const skin_block *block, int32_t *sums)
{
    const uint16_t taxels = skin_readings(board), first = (uint16_t)(number * board->type->block_size);
    uint16_t *newest = &readings[(uint32_t)(samples - 1) * taxels + first];
    uint16_t saturated;
#if SKIN_SAMPLES > 1
    float averages[SKIN_BLOCK_SIZE];
    uint16_t place;

    skin_take_samples(state, &readings[first], samples, taxels, averages);
    saturated = skin_read_block(board, newest, block->gain, block->offset, *block->pattern);
    for (place = 0; place < board->type->block_size; place++) {
        averages[place] = *block->pattern != SKIN_PATTERN_OFF
                              ? (float)newest[place]
                              : correct(averages[place], block->gain[place], block->offset[place], board->type->count_max);
    }
    block_sums(board, number, averages, sums);
#else
    int32_t work[SKIN_BLOCK_SIZE];

    (void)state;
    saturated = skin_read_block(board, newest, block->gain, block->offset, *block->pattern);
    skin_block_sums(board, number, newest, work, sums);
#endif
    memcpy(block->counts, newest, board->type->block_size * sizeof newest[0]);
    return saturated;
}

#endif
