#include "skin_average.h"

#if SKIN_SAMPLES > 1 /* boards that sample at the SYNC only need no average */

#include <math.h>
#include <string.h>

/* Samples over which the noise of a taxel is learned. */
#define MEMORY 256
/* Variance of rounding to whole counts. */
#define ROUNDING (1.0f / 12.0f)
/* A squared second difference counts for so many times its mean at most: more is a touch. */
#define OUTLIER_RATIO 16.0f
/* A taxel is idle while mean and deviation, and size and square of second differences, are those of clipped noise. */
#define IDLE_BAND 0.25f
#define EVENNESS 0.4f
/* The noise of a block is learned while this part of its taxels is idle, by this part of the difference. */
#define IDLE_PART 8
#define LEARNING_GAIN 0.005f
/* A force of fewer deviations of its average is 0. */
#define DEAD_RATIO 2.0f
/* Mean and deviation of noise N(0, 1) that is clipped at 0. */
#define IDLE_MEAN 0.39894228f
#define IDLE_DEVIATION 0.58369524f
/* Chance of a change of filter in one sample; least weight of a filter. */
#define SWITCHING 0.001f
#define LEAST_WEIGHT 1e-9f

/* A filter: gains of level and slope, 1 / (2 S) and ln(S) / 2 of the innovation's variance S, variance of the level. */
typedef struct {
    float gain, slope_gain, half_precision, log_spread, variance;
} model;

/* A jump, the average with gain 1/256, and trends with memories of 4, 16 and 64 samples. */
static const model models[SKIN_MODELS] = {
    {1.0f, 0.0f, 0.0625f, 1.03972077f, 1.0f},
    {0.00390625f, 0.0f, 0.499023438f, 0.000977517455f, 0.00195694715f},
    {0.4375f, 0.0625f, 0.334960938f, 0.200297087f, 0.399416924f},
    {0.12109375f, 0.00390625f, 0.459964812f, 0.0417290702f, 0.0827431083f},
    {0.0310058594f, 0.000244140625f, 0.490167618f, 0.00993035082f, 0.0198092833f},
};

/* Mean of x + N(0, 1) clipped at 0, for x from 0 to CLIPPED_REACH. */
#define CLIPPED_POINTS 129
#define CLIPPED_REACH 6.0f
static const float clipped_mean[CLIPPED_POINTS] = {
    0.39894228f, 0.42281799f, 0.44756916f, 0.47319291f, 0.49968446f, 0.52703717f, 0.55524257f, 0.58429041f,
    0.61416876f, 0.64486404f, 0.67636115f, 0.70864352f, 0.74169326f, 0.77549123f, 0.81001715f, 0.84524976f,
    0.88116692f, 0.9177457f, 0.95496255f, 0.99279343f, 1.0312139f, 1.0701992f, 1.1097244f, 1.1497647f,
    1.1902953f, 1.2312915f, 1.2727288f, 1.3145832f, 1.3568313f, 1.3994498f, 1.4424163f, 1.485709f,
    1.5293068f, 1.5731892f, 1.6173366f, 1.6617303f, 1.7063523f, 1.7511853f, 1.7962133f, 1.8414207f,
    1.8867931f, 1.9323167f, 1.9779786f, 2.0237668f, 2.06967f, 2.1156778f, 2.1617803f, 2.2079687f,
    2.2542346f, 2.3005702f, 2.3469686f, 2.3934233f, 2.4399283f, 2.4864783f, 2.5330684f, 2.5796942f,
    2.6263515f, 2.6730368f, 2.7197469f, 2.7664787f, 2.8132298f, 2.8599976f, 2.9067801f, 2.9535755f,
    3.0003822f, 3.0471985f, 3.0940234f, 3.1408555f, 3.187694f, 3.234538f, 3.2813866f, 3.3282393f,
    3.3750955f, 3.4219546f, 3.4688162f, 3.51568f, 3.5625455f, 3.6094126f, 3.6562811f, 3.7031506f,
    3.750021f, 3.7968923f, 3.8437641f, 3.8906365f, 3.9375094f, 3.9843827f, 4.0312562f, 4.07813f,
    4.1250041f, 4.1718783f, 4.2187527f, 4.2656271f, 4.3125017f, 4.3593764f, 4.4062511f, 4.4531259f,
    4.5000007f, 4.5468756f, 4.5937504f, 4.6406253f, 4.6875003f, 4.7343752f, 4.7812502f, 4.8281251f,
    4.8750001f, 4.9218751f, 4.9687501f, 5.015625f, 5.0625f, 5.109375f, 5.15625f, 5.203125f,
    5.25f, 5.296875f, 5.34375f, 5.390625f, 5.4375f, 5.484375f, 5.53125f, 5.578125f,
    5.625f, 5.671875f, 5.71875f, 5.765625f, 5.8125f, 5.859375f, 5.90625f, 5.953125f,
    6.0f,
};

static float larger(float a, float b)
{
    return a > b ? a : b;
}

static float smaller(float a, float b)
{
    return a < b ? a : b;
}

/* 2^exponent for -120 <= exponent <= 0, error below 2e-7. */
static float power_of_two(float exponent)
{
    const int32_t whole = (int32_t)(exponent + 128.0f) - 128; /* rounded down */
    const float rest = exponent - (float)whole;
    const uint32_t bits = (uint32_t)(whole + 127) << 23;
    float power, polynomial;

    memcpy(&power, &bits, sizeof power);
    polynomial = 0.00894959f + rest * 0.00189375f;
    polynomial = 0.24014182f + rest * (0.05586034f + rest * polynomial);
    polynomial = 0.9999999f + rest * (0.69315449f + rest * polynomial);
    return polynomial * power;
}

/* Force whose clipped mean is `mean`; both in units of the noise's deviation. */
static float unclipped(float mean)
{
    uint16_t low = 0, high = CLIPPED_POINTS - 1;

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
    return CLIPPED_REACH / (CLIPPED_POINTS - 1) *
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
    float gain = 1.0f / MEMORY, limit = 0.0f;
    uint16_t c;

    if (state->age == 0) {
        memset(state->square, 0, sizeof state->square);
        memset(state->size, 0, sizeof state->size);
    } else if (state->age > 1) {
        gain = state->age <= MEMORY ? 1.0f / (float)(state->age - 1) : gain;
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            float found = fabsf(sample[c] - 2.0f * state->last[0][c] + state->last[1][c]);

            if (state->age > MEMORY) {
                limit = sqrtf(OUTLIER_RATIO * larger(state->square[c], 6.0f * ROUNDING));
                found = smaller(found, limit);
            }
            state->square[c] += gain * (found * found - state->square[c]);
            state->size[c] += gain * (found - state->size[c]);
        }
    }
    memcpy(state->last[1], state->last[0], sizeof state->last[0]);
    memcpy(state->last[0], sample, sizeof state->last[0]);
    if (state->age < 2 * MEMORY) {
        state->age++;
    }
}

/* Deviation of a taxel's noise before clipping, which makes it smaller where nothing touches. */
static float deviation(const skin_average *state, uint16_t c)
{
    const float seen = sqrtf(larger(state->square[c] / 6.0f, ROUNDING));

    return state->noise > 0.0f ? larger(state->noise, seen) : seen / IDLE_DEVIATION;
}

/* Run all filters on one sample of each taxel, in units of their scales. */
static void step(skin_average *state, const float *sample)
{
    const float change = SWITCHING / (SKIN_MODELS - 1), stay = 1.0f - SWITCHING;
    float level_mean[SKIN_BLOCK_SIZE] = {0}, slope_mean[SKIN_BLOCK_SIZE] = {0}, least[SKIN_BLOCK_SIZE];
    float surprise[SKIN_MODELS][SKIN_BLOCK_SIZE], total[SKIN_BLOCK_SIZE] = {0};
    uint16_t c;
    uint8_t m;

    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            level_mean[c] += state->weight[m][c] * state->level[m][c];
            slope_mean[c] += state->weight[m][c] * state->slope[m][c];
        }
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        const model each = models[m];
        const float has_slope = each.slope_gain > 0.0f ? 1.0f : 0.0f;

        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            const float kept = (stay - change) * state->weight[m][c], likely = change + kept, scale = 1.0f / likely;
            const float slope = (change * slope_mean[c] + kept * state->slope[m][c]) * scale * has_slope;
            const float predicted = (change * level_mean[c] + kept * state->level[m][c]) * scale + slope;
            const float innovation = sample[c] - predicted;

            state->level[m][c] = predicted + each.gain * innovation;
            state->slope[m][c] = slope + each.slope_gain * innovation;
            state->weight[m][c] = likely;
            surprise[m][c] = innovation * innovation * each.half_precision + each.log_spread;
        }
    }
    memcpy(least, surprise[0], sizeof least);
    for (m = 1; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            least[c] = smaller(least[c], surprise[m][c]);
        }
    }
    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            state->weight[m][c] *= power_of_two(larger((least[c] - surprise[m][c]) * 1.44269504f, -120.0f));
            total[c] += state->weight[m][c];
        }
    }
    memset(state->average, 0, sizeof state->average);
    memset(state->variance, 0, sizeof state->variance);
    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            const float weight = larger(state->weight[m][c] / total[c], LEAST_WEIGHT);

            state->weight[m][c] = weight;
            state->average[c] += weight * state->level[m][c];
            state->variance[c] += weight * models[m].variance;
        }
    }
}

/* Express levels and slopes in units of the new scale, or begin them with a first sample. */
static void change_scale(skin_average *state, const float *scale, const float *first)
{
    uint16_t c;
    uint8_t m;

    for (m = 0; m < SKIN_MODELS; m++) {
        for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
            if (first != NULL) {
                state->level[m][c] = first[c] / scale[c];
                state->slope[m][c] = 0.0f;
                state->weight[m][c] = 1.0f / SKIN_MODELS;
            } else {
                state->level[m][c] *= state->scale[c] / scale[c];
                state->slope[m][c] *= state->scale[c] / scale[c];
            }
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
        const float clean = larger(state->square[c] / 6.0f - ROUNDING, 0.0f);
        const float expected = sqrtf(clean) * (IDLE_MEAN / IDLE_DEVIATION);

        if (fabsf(state->average[c] - expected) < IDLE_BAND * expected &&
            state->size[c] * state->size[c] > EVENNESS * state->square[c] && state->age >= MEMORY) {
            for (place = count++; place > 0 && ordered[place - 1] > clean; place--) {
                ordered[place] = ordered[place - 1];
            }
            ordered[place] = clean;
        }
    }
    if (count == 0 || IDLE_PART * count < SKIN_BLOCK_SIZE) {
        return;
    }
    found = sqrtf((ordered[(count - 1) / 2] + ordered[count / 2]) / 2.0f) / IDLE_DEVIATION;
    state->noise = state->noise > 0.0f ? state->noise + LEARNING_GAIN * (found - state->noise) : found;
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
        step(state, sample);
    }
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        state->average[c] *= scale[c];
    }
    learn_noise(state);
    for (c = 0; c < SKIN_BLOCK_SIZE; c++) {
        float force = state->average[c];

        if (state->noise > 0.0f) {
            force = unclipped(force / state->noise) * state->noise;
            if (force < DEAD_RATIO * sqrtf(state->variance[c]) * scale[c]) {
                force = 0.0f;
            }
        }
        averages[c] = force;
    }
}

float skin_correct_average(float average, float gain, int16_t offset, uint16_t count_max)
{
    /* Volatile: product and sum are rounded to 32 bits each, also where the processor could fuse both. */
    volatile float product = average * gain, corrected;

    corrected = product + (float)offset;
    return corrected > 0.0f ? smaller(corrected, (float)count_max) : 0.0f;
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

void skin_average_sums(const skin_board *board, uint8_t block, float *values, int32_t *sums)
{
    const uint16_t first_sum = board->first_sum[block], end = board->first_sum[block + 1];
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
        sums[sum - first_sum] = nearest(values[board->rows[sum]]);
    }
}

#endif

uint16_t skin_measure(const skin_board *board, uint8_t block, skin_average *state, uint16_t *counts, uint16_t samples,
                      const float *gain, const int16_t *offset, uint8_t pattern, int32_t *sums)
{
    const uint16_t taxels = (uint16_t)(board->blocks * board->block_size);
    const uint16_t first = (uint16_t)(block * board->block_size);
    uint16_t *newest = &counts[(uint32_t)(samples - 1) * taxels + first];
    uint16_t saturated;
#if SKIN_SAMPLES > 1
    float averages[SKIN_BLOCK_SIZE];
    uint16_t place;

    skin_take_samples(state, &counts[first], samples, taxels, averages);
    saturated = skin_read_block(board, newest, gain, offset, pattern);
    for (place = 0; place < board->block_size; place++) {
        averages[place] = pattern != SKIN_PATTERN_OFF
                              ? (float)newest[place]
                              : skin_correct_average(averages[place], gain[place], offset[place], board->count_max);
    }
    skin_average_sums(board, block, averages, sums);
#else
    int32_t work[SKIN_BLOCK_SIZE];

    (void)state;
    saturated = skin_read_block(board, newest, gain, offset, pattern);
    skin_block_sums(board, block, newest, work, sums);
#endif
    return saturated;
}
