/* From the samples of a patch to its sums: noise that is learned and filtered away, clipping undone, drifts followed
 * ("What a board computes each millisecond" in docs/steps.md).
 *
 * All arithmetic on forces is binary32, every operation rounded as written: compile without -ffast-math and with
 * -ffp-contract=off. One sample takes about 8,000 operations: a floating point unit is needed.
 */
#ifndef SKIN_FILTER_H
#define SKIN_FILTER_H

#include "stepped.h"
#include "skin_models.h"

/* Sums over the samples of an untouched patch at power-up. */
typedef struct {
    double sum[SKIN_BLOCK_SUMS], square[SKIN_BLOCK_SUMS];
    double partial[SKIN_SPAN_COUNT][SKIN_BLOCK_SUMS], mean[SKIN_SPAN_COUNT][SKIN_BLOCK_SUMS];
    double mean_square[SKIN_SPAN_COUNT][SKIN_BLOCK_SUMS];
} skin_idle;

typedef struct {
    union { /* learning ends before filtering begins */
        skin_idle idle;
        skin_tracks tracks; /* of every Haar coefficient, in units of its noise */
    } u;
    uint16_t taxels; /* of the board, without empty places */
    uint16_t taken; /* samples since power-up, at most SKIN_IDLE_SAMPLES + SKIN_SETTLING_SAMPLES */
    float idle_offset_n[SKIN_BLOCK_SUMS]; /* of power-up */
    float learned_taxel_n[SKIN_BLOCK_SUMS], learned_coefficient_n[SKIN_BLOCK_SUMS];
    float given_taxel_n[SKIN_BLOCK_SUMS], given_coefficient_n[SKIN_BLOCK_SUMS]; /* 2033h and 2032h as written; 0: learned */
    float taxel_n[SKIN_BLOCK_SUMS], coefficient_n[SKIN_BLOCK_SUMS];             /* in use */
    double noise_n;                                                   /* 2035h: root mean square of coefficient_n */
    float offset_n[SKIN_BLOCK_SUMS];
    uint8_t shows_pattern; /* the samples are those of a test pattern: offsets stay */
    uint16_t in_window;
    float total_n[SKIN_BLOCK_SUMS], square_n2[SKIN_BLOCK_SUMS], last_n[SKIN_BLOCK_SUMS];
    float variance[SKIN_BLOCK_SUMS]; /* of the forecast of each coefficient, in units of its noise's */
    float sums_n[SKIN_BLOCK_SUMS];
} skin_filter;

extern const float skin_unclip_table[SKIN_UNCLIP_POINTS];
/* Hadamard row of each sum; first coefficient and number of coefficients whose variances make up that of the sum. */
extern const uint8_t skin_row_of_sum[SKIN_BLOCK_SUMS], skin_band_of_sum[SKIN_BLOCK_SUMS], skin_band_size[SKIN_BLOCK_SUMS];

/* Take one sample, corrected counts of all taxels; afterwards sums_n are those of now.
 *
 * Returns 0 while the board learns its noise and its filter settles: nothing may touch the patch, and there are no sums.
 */
int skin_filter_take(skin_filter *filter, const uint16_t *counts);

/* Use given_taxel_n and given_coefficient_n from now on. */
void skin_filter_give(skin_filter *filter);

/* Write the variance of each sum, newtons squared. */
void skin_filter_variance(const skin_filter *filter, float *variance_n2);

/* A sum of the filtered forces, ADC counts, in the order of 2003h. */
int32_t skin_filter_sum(const skin_filter *filter, const skin_board *board, uint8_t number);

/* Between the parts of the filter. skin_learned_noise leaves clipping in the offsets. */
void skin_to_haar(float *value, float *coefficients);
void skin_from_haar(const float *coefficients, float *value);
void skin_learn_idle(skin_idle *idle, uint16_t count, const float *sample_n);
void skin_learned_noise(skin_filter *filter);

#endif
