#include "skin_sums.h"

/* Multiply `work` by the Hadamard matrix of +1 and -1 in Sylvester's order; `size` is a power of two. */
static void hadamard(int32_t *work, uint16_t size)
{
    uint16_t half, first, place;

    for (half = 1; half < size; half = (uint16_t)(2 * half)) {
        for (first = 0; first < size; first = (uint16_t)(first + 2 * half)) {
            for (place = first; place < first + half; place++) {
                const int32_t above = work[place], below = work[place + half];

                work[place] = above + below;
                work[place + half] = above - below;
            }
        }
    }
}

/* Limit a whole number to 0 to `count_max`. */
static uint16_t limited(int32_t value, uint16_t count_max)
{
    return (uint16_t)(value < 0 ? 0 : value > count_max ? count_max : value);
}

/* Return round(gain * counts + offset), limited to 0 to `count_max`; halves are rounded to even. */
static uint16_t correct(uint16_t counts, float gain, int16_t offset, uint16_t count_max)
{
    /* Volatile: product and sum are rounded to 32 bits each, also where the processor could fuse both. */
    volatile float product, corrected;
    int32_t whole;
    float rest;

    if (gain == 1.0f) {
        return limited((int32_t)counts + offset, count_max);
    }
    product = (float)counts * gain;
    corrected = product + (float)offset;
    if (!(corrected > 0.0f)) {
        return 0;
    }
    if (corrected >= (float)count_max) {
        return count_max;
    }
    whole = (int32_t)corrected;
    rest = corrected - (float)whole; /* exact */
    if (rest > 0.5f || (rest == 0.5f && (whole & 1) != 0)) {
        whole++;
    }
    return (uint16_t)whole;
}

uint16_t skin_read_block(const skin_board *board, uint16_t *counts, const float *gain, const int16_t *offset,
                         uint8_t pattern)
{
    uint16_t place, saturated = 0;

    for (place = 0; place < board->type->block_size; place++) {
        switch (pattern) {
        case SKIN_PATTERN_ZERO:
            counts[place] = 0;
            break;
        case SKIN_PATTERN_RAMP:
            counts[place] = place < board->type->count_max ? place : board->type->count_max;
            break;
        case SKIN_PATTERN_FULL:
            counts[place] = board->type->count_max;
            break;
        default:
            counts[place] = correct(counts[place], gain[place], offset[place], board->type->count_max);
            break;
        }
        saturated = (uint16_t)(saturated + (counts[place] >= board->type->count_max));
    }
    return saturated;
}

void skin_block_sums(const skin_board *board, uint8_t block, const uint16_t *counts, int32_t *work, int32_t *sums)
{
    const uint16_t first = board->type->first_sum[block], end = board->type->first_sum[block + 1];
    uint16_t place, sum;

    for (place = 0; place < board->type->block_size; place++) {
        work[place] = counts[place];
    }
    hadamard(work, board->type->block_size);
    for (sum = first; sum < end; sum++) {
        sums[sum - first] = work[SKIN_ROWS(board)[sum]];
    }
}

#if SKIN_ANALOGUE

int32_t skin_code(const skin_board *board, int32_t sum)
{
    const int32_t size = board->type->block_size, half = ((int32_t)board->type->count_max + 1) / 2;
    const int32_t rest = (sum % size + size) % size;
    int32_t code = (sum - rest) / size;

    if (2 * rest > size || (2 * rest == size && code % 2 != 0)) {
        code++;
    }
    return code < -half ? -half : code < half ? code : half - 1;
}

#endif

/* Quotient of `value` and 2^shift, rounded down; a shift of negative numbers is left to the compiler by the standard. */
static int32_t shifted(int32_t value, uint8_t shift)
{
    return value < 0 ? ~(~value >> shift) : value >> shift;
}

int32_t skin_raw(const skin_packing *packing, int32_t sum)
{
    const uint8_t bits = (uint8_t)(packing->bits - (packing->offset == 0)); /* without a sign */
    const int32_t most = ((int32_t)1 << bits) - 1;
    int32_t raw = sum;

    if (packing->step_log2 > 0) {
        raw = shifted(sum + ((int32_t)1 << (packing->step_log2 - 1)) - (sum > 0), packing->step_log2);
    }
    raw += packing->offset;
    return SKIN_ANALOGUE && raw > most ? most : raw; /* the highest codes may round to more */
}

void skin_put_bits(uint8_t *payload, uint16_t at, uint32_t value, uint8_t bits)
{
    uint8_t done = 0;

    while (done < bits) {
        const uint16_t bit = (uint16_t)(at + done);
        const uint8_t shift = (uint8_t)(bit & 7u);
        const uint8_t above = (uint8_t)(8u - shift), left = (uint8_t)(bits - done);
        const uint8_t count = above < left ? above : left;

        payload[bit >> 3] = (uint8_t)(payload[bit >> 3] | (((value >> done) & ((1u << count) - 1u)) << shift));
        done = (uint8_t)(done + count);
    }
}

int skin_is_turn(uint8_t every, uint8_t start, uint8_t counter)
{
    return every > 0 && (counter + 2u * SKIN_LAST_SYNCHRONOUS - start) % SKIN_LAST_SYNCHRONOUS % every == 0; /* not below 0 */
}

uint32_t skin_crc32(uint32_t crc, const uint8_t *data, uint16_t length)
{
    uint16_t place;
    uint8_t bit;

    crc = ~crc;
    for (place = 0; place < length; place++) {
        crc ^= data[place];
        for (bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
        }
    }
    return ~crc & 0xFFFFFFFFu;
}
