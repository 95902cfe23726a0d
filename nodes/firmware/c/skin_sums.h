/* Sums of taxels and their packing into frames. No function keeps state or allocates memory. */
#ifndef SKIN_SUMS_H
#define SKIN_SUMS_H

#include "board.h"

/* What the taxels of one block read.
 *
 * counts: in the order of the chain, board->type->block_size values; corrected in place, or replaced by the test pattern.
 * Returns the number of taxels at the top of their range.
 */
uint16_t skin_read_block(const skin_board *board, uint16_t *counts, const float *gain, const int16_t *offset,
                         uint8_t pattern);

/* Sums of one block in ADC counts.
 *
 * counts: what `skin_read_block` leaves. work: room for board->type->block_size values.
 * sums: room for the sums of the block, board->type->first_sum[block + 1] - board->type->first_sum[block].
 */
void skin_block_sums(const skin_board *board, uint8_t block, const uint16_t *counts, int32_t *work, int32_t *sums);

/* What the converter of a sum reads of taxels with this sum in counts: rounded, ties to even, limited to its range. */
int32_t skin_code(const skin_board *board, int32_t sum);

/* Value in a PDO of a sum in counts; the lowest `bits` of the result are sent. */
int32_t skin_raw(const skin_packing *packing, int32_t sum);

/* Write the lowest `bits` (1 to 32) of `value` into `payload` behind its first `at` bits; the bits there must be 0. */
void skin_put_bits(uint8_t *payload, uint16_t at, uint32_t value, uint8_t bits);

/* Whether a PDO of a cyclic transmission type answers the SYNC of a counter, by its SYNC start value (18xxh:2, 18xxh:6). */
int skin_is_turn(uint8_t every, uint8_t start, uint8_t counter);

/* CRC-32 (IEEE 802.3) of more bytes; begin with 0. */
uint32_t skin_crc32(uint32_t crc, const uint8_t *data, uint16_t length);

#endif
