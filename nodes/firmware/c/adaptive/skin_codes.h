/* Bytes of an adaptive board's sums: coarse and fine codes ("Frames" in docs/adaptive.md). Sums are newtons. */
#ifndef SKIN_CODES_H
#define SKIN_CODES_H

#include "adaptive.h"

/* Least sums of the codes 1, 2, ...; values of the codes 0, 1, ... (of the others: 128, 129, ...). */
extern const double skin_mean_least[SKIN_MEAN_CODES], skin_mean_value[SKIN_MEAN_CODES + 1];
extern const double skin_other_least[SKIN_OTHER_CODES], skin_other_value[SKIN_OTHER_CODES + 1];

/* Code of sum number `place` in a coarse frame, and the value of a code. */
uint8_t skin_coarse_code(double sum_n, uint8_t place);
double skin_coarse_value(uint8_t code, uint8_t place);

/* Tell whether a difference from a value exceeds `steps` times the distance of neighbouring coarse values there. */
int skin_is_beyond(double error_n, double steps, double known_n, uint8_t place);

/* A sum in fine steps. */
int32_t skin_fine_steps(double sum_n);

/* CRC-8 of eight coarse codes. */
uint8_t skin_check_of(const uint8_t *codes);

/* Write eight fine codes: the low seven bits of each number of steps, then the check. */
void skin_pack_fine(const int32_t *steps, uint8_t check, uint8_t *payload);

/* Value of sum `place` of a group in a fine frame: of all numbers with the sent bits that nearest to the coarse value, whose
 * fine steps are `near`.
 */
double skin_fine_value(const uint8_t *payload, uint8_t place, int32_t near);

#endif
