#include "skin_filter.h"

#include <math.h>
#include <string.h>

/* Undo the bias of clipping at 0 in place. */
static void unclip(float *force_n, const float *noise_n)
{
    const float last = SKIN_UNCLIP_POINTS - 1;
    uint8_t c;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        const float reading = force_n[c] / noise_n[c], at = reading * SKIN_UNCLIP_SCALE;
        const float place = skin_larger(0.0f, skin_smaller(at, last));
        const int32_t low = (int32_t)skin_smaller(place, last - 1.0f);
        const float part = place - (float)low;
        const float unclipped = skin_unclip_table[low] + part * (skin_unclip_table[low + 1] - skin_unclip_table[low]);

        force_n[c] = noise_n[c] * (at < last ? unclipped : reading);
    }
}

/* Tell whether a taxel and its neighbours in the patch are quiet. */
static uint8_t is_quiet_around(const uint8_t *is_quiet, uint8_t place)
{
    const int8_t row = (int8_t)(place / SKIN_PATCH_WIDE), column = (int8_t)(place % SKIN_PATCH_WIDE);
    int8_t down, across;

    for (down = (int8_t)(row - 1); down <= row + 1; down++) {
        for (across = (int8_t)(column - 1); across <= column + 1; across++) {
            if (0 <= down && down < SKIN_PATCH_HIGH && 0 <= across && across < SKIN_PATCH_WIDE &&
                !is_quiet[SKIN_PATCH_WIDE * down + across]) {
                return 0;
            }
        }
    }
    return 1;
}

/* Take the offsets from the forces, in place, and follow them where a taxel and its neighbours are quiet. */
static void follow(skin_filter *filter, float *force_n)
{
    uint8_t is_quiet[SKIN_BLOCK_SUMS], loud = 0, place;

    for (place = 0; place < SKIN_BLOCK_SUMS; place++) {
        force_n[place] -= filter->offset_n[place];
        is_quiet[place] = force_n[place] < SKIN_QUIET_RATIO * filter->taxel_n[place];
        loud = (uint8_t)(loud + !is_quiet[place]);
    }
    for (place = 0; !filter->shows_pattern && place < SKIN_BLOCK_SUMS; place++) {
        if (loud == 0 || is_quiet_around(is_quiet, place)) {
            const float offset_n = filter->offset_n[place], idle_n = filter->idle_offset_n[place];
            const float most_n = offset_n < idle_n ? SKIN_RETURN_N : SKIN_RISE_N;
            const float change_n = skin_smaller(most_n, skin_larger(-SKIN_RATE_N, SKIN_FOLLOWING * force_n[place]));
            const float raised_n = skin_smaller(idle_n + SKIN_HIGHEST_N, offset_n + change_n);

            filter->offset_n[place] = skin_larger(SKIN_LOWEST_RATIO * filter->taxel_n[place], raised_n);
        }
    }
}

/* Look at raw samples; every SKIN_WINDOW samples return by what to multiply the noise, else 0. */
static float judge(skin_filter *filter)
{
    float ratios[SKIN_BLOCK_SUMS], median;
    uint8_t c, idle = 0, place;

    if (++filter->in_window < SKIN_WINDOW) {
        return 0;
    }
    filter->in_window = 0;
    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        const float mean = filter->total_n[c] / (float)SKIN_WINDOW;
        const float deviation = sqrtf(filter->square_n2[c] / (float)(2 * SKIN_WINDOW));

        filter->total_n[c] = filter->square_n2[c] = 0;
        if (deviation > 0 && SKIN_LEAST_IDLE_RATIO * deviation < mean && mean < SKIN_MOST_IDLE_RATIO * deviation) {
            const float ratio = deviation / ((float)SKIN_IDLE_DEVIATION * filter->learned_taxel_n[c]);

            for (place = idle++; place > 0 && ratios[place - 1] > ratio; place--) { /* in ascending order */
                ratios[place] = ratios[place - 1];
            }
            ratios[place] = ratio;
        }
    }
    if (idle == 0 || (float)idle < SKIN_IDLE_PART * (float)filter->taxels) {
        return 1;
    }
    median = idle % 2 != 0 ? ratios[idle / 2] : (ratios[idle / 2 - 1] + ratios[idle / 2]) * 0.5f;
    return sqrtf(sqrtf(median));
}

/* Find the noise in use; levels and slopes are in units of the coefficients' noise. */
static void use(skin_filter *filter)
{
    skin_tracks *tracks = &filter->u.tracks;
    double square = 0;
    uint8_t c, model;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        const float before_n = filter->coefficient_n[c];
        float ratio;

        filter->taxel_n[c] = filter->given_taxel_n[c] > 0 ? filter->given_taxel_n[c] : filter->learned_taxel_n[c];
        filter->coefficient_n[c] =
            filter->given_coefficient_n[c] > 0 ? filter->given_coefficient_n[c] : filter->learned_coefficient_n[c];
        square += (double)filter->coefficient_n[c] * (double)filter->coefficient_n[c];
        ratio = filter->coefficient_n[c] / before_n;
        for (model = 0; model < SKIN_MODELS; model++) {
            tracks->level[model][c] /= ratio;
        }
        for (model = 0; model < SKIN_MODELS - SKIN_AVERAGE_COUNT; model++) {
            tracks->slope[model][c] /= ratio;
        }
    }
    filter->noise_n = sqrt(square / SKIN_BLOCK_SUMS);
}

/* Go over from learning to filtering. */
static void begin_tracks(skin_filter *filter)
{
    uint8_t c;

    skin_learned_noise(filter);
    unclip(filter->idle_offset_n, filter->learned_taxel_n);
    memcpy(filter->offset_n, filter->idle_offset_n, sizeof filter->offset_n);
    memcpy(filter->taxel_n, filter->learned_taxel_n, sizeof filter->taxel_n);
    memcpy(filter->coefficient_n, filter->learned_coefficient_n, sizeof filter->coefficient_n);
    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        skin_begin_track(&filter->u.tracks, c, 0);
    }
    use(filter);
}

void skin_filter_give(skin_filter *filter)
{
    if (filter->taken >= SKIN_IDLE_SAMPLES) {
        use(filter);
    }
}

/* Filter one sample, newtons, which is overwritten. */
static void take(skin_filter *filter, float *sample_n)
{
    float coefficients[SKIN_BLOCK_SUMS], forecast[SKIN_BLOCK_SUMS];
    float scale;
    uint8_t c;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        const float change_n = sample_n[c] - filter->last_n[c];

        filter->square_n2[c] += change_n * change_n;
        filter->total_n[c] += sample_n[c];
        filter->last_n[c] = sample_n[c];
    }
    skin_to_haar(sample_n, coefficients);
    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        coefficients[c] /= filter->coefficient_n[c];
    }
    skin_step(&filter->u.tracks, coefficients, forecast, filter->variance);
    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        coefficients[c] = forecast[c] * filter->coefficient_n[c];
    }
    skin_from_haar(coefficients, sample_n);
    unclip(sample_n, filter->taxel_n);
    follow(filter, sample_n);
    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        sample_n[c] = sample_n[c] < SKIN_DEAD_RATIO * filter->taxel_n[c] ? 0 : sample_n[c];
    }
    scale = judge(filter);
    if (scale > 0) {
        for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
            filter->learned_taxel_n[c] *= scale;
            filter->learned_coefficient_n[c] *= scale;
        }
        use(filter);
    }
}

/* The Walsh sums of `value`, which is overwritten. */
static void to_walsh(float *value, float *sums)
{
    uint8_t half, first, place;

    for (half = 1; half < SKIN_BLOCK_SUMS; half = (uint8_t)(2 * half)) {
        for (first = 0; first < SKIN_BLOCK_SUMS; first = (uint8_t)(first + 2 * half)) {
            for (place = first; place < first + half; place++) {
                const float above = value[place], below = value[place + half];

                value[place] = above + below;
                value[place + half] = above - below;
            }
        }
    }
    for (place = 0; place < SKIN_BLOCK_SUMS; place++) {
        sums[place] = value[skin_row_of_sum[place]];
    }
}

int skin_filter_take(skin_filter *filter, const uint16_t *counts)
{
    float sample_n[SKIN_BLOCK_SUMS];
    uint8_t c;

    for (c = 0; c < SKIN_BLOCK_SUMS; c++) {
        sample_n[c] = (float)counts[c] * (float)SKIN_NEWTON_PER_COUNT;
    }
    if (filter->taken < SKIN_IDLE_SAMPLES) {
        filter->taken++;
        skin_learn_idle(&filter->u.idle, filter->taken, sample_n);
        if (filter->taken == SKIN_IDLE_SAMPLES) {
            begin_tracks(filter);
        }
        return 0;
    }
    take(filter, sample_n);
    to_walsh(sample_n, filter->sums_n);
    if (filter->taken < SKIN_IDLE_SAMPLES + SKIN_SETTLING_SAMPLES) {
        filter->taken++;
        return filter->taken == SKIN_IDLE_SAMPLES + SKIN_SETTLING_SAMPLES;
    }
    return 1;
}

void skin_filter_variance(const skin_filter *filter, float *variance_n2)
{
    uint8_t place, c;

    for (place = 0; place < SKIN_BLOCK_SUMS; place++) {
        const uint8_t first = skin_band_of_sum[place], count = skin_band_size[place];
        float total = 0;

        for (c = first; c < first + count; c++) {
            total += filter->variance[c] * (filter->coefficient_n[c] * filter->coefficient_n[c]);
        }
        variance_n2[place] = total * (float)(SKIN_BLOCK_SUMS / count);
    }
}

int32_t skin_filter_sum(const skin_filter *filter, const skin_board *board, uint8_t number)
{
    const float most = (float)SKIN_BLOCK_SUMS * board->type->count_max;
    uint8_t place = 0;

    while (place < SKIN_BLOCK_SUMS - 1 && skin_row_of_sum[place] != SKIN_ROWS(board)[number]) {
        place++;
    }
    /* A forecast may exceed what taxels can read, and a sum its type. */
    return (int32_t)skin_larger(-most, skin_smaller(most, rintf(filter->sums_n[place] / (float)SKIN_NEWTON_PER_COUNT)));
}
