#include "skin_codes.h"

#include <math.h>
#include <string.h>

#include "skin_sums.h"

#define FINE_MASK ((1u << SKIN_FINE_BITS) - 1u)

/* The bits of a number above 0 as an integer, which has the same order: quicker to compare without 64-bit hardware. */
static int64_t bits_of(const double *value)
{
    int64_t bits;

    memcpy(&bits, value, sizeof bits);
    return bits;
}

/* Number of the `count` ascending values that are at most `value`. */
static uint8_t rank_of(double value, const double *least, uint8_t count)
{
    const int64_t bits = bits_of(&value);
    uint8_t low = 0, high = count;

    if (!(value > 0)) {
        return 0;
    }
    while (low < high) {
        const uint8_t middle = (uint8_t)((low + high) / 2);

        if (bits_of(&least[middle]) <= bits) {
            low = (uint8_t)(middle + 1);
        } else {
            high = middle;
        }
    }
    return low;
}

uint8_t skin_coarse_code(double sum_n, uint8_t place)
{
    if (place == 0) {
        return rank_of(sum_n, skin_mean_least, SKIN_MEAN_CODES);
    }
    return sum_n < 0 ? (uint8_t)(SKIN_OTHER_CODES + 1 - rank_of(-sum_n, skin_other_least, SKIN_OTHER_CODES))
                     : (uint8_t)(SKIN_OTHER_CODES + 1 + rank_of(sum_n, skin_other_least, SKIN_OTHER_CODES));
}

double skin_coarse_value(uint8_t code, uint8_t place)
{
    const int distance = code - (SKIN_OTHER_CODES + 1);

    if (place == 0) {
        return skin_mean_value[code];
    }
    /* Code 0 is never sent. */
    return distance < 0 ? -skin_other_value[distance < -SKIN_OTHER_CODES ? SKIN_OTHER_CODES : -distance]
                        : skin_other_value[distance];
}

int skin_is_beyond(double error_n, double steps, double known_n, uint8_t place)
{
    const double knee_n = place == 0 ? SKIN_MEAN_KNEE_N : SKIN_KNEE_N;
    const double slope = place == 0 ? SKIN_MEAN_SLOPE : SKIN_SLOPE;
    /* Clear cases by single precision. */
    const float known = (float)known_n, knee = (float)knee_n, error = fabsf((float)error_n);
    const float quick = (float)steps * (sqrtf(known * known + knee * knee) / (float)slope);

    if (error > quick * 1.0001f) {
        return 1;
    }
    if (error < quick * 0.9999f) {
        return 0;
    }
    return fabs(error_n) > steps * (sqrt(known_n * known_n + knee_n * knee_n) / slope);
}

int32_t skin_fine_steps(double sum_n)
{
    /* Clear cases by single precision, whose error here is below 0.01 steps. */
    const float quick = (float)sum_n * (float)(1.0 / SKIN_FINE_N), whole = rintf(quick);

    if (fabsf(quick) < 32768.0f && fabsf(quick - whole) < 0.49f) {
        return (int32_t)whole;
    }
    return (int32_t)rint(sum_n / SKIN_FINE_N);
}

uint8_t skin_check_of(const uint8_t *codes)
{
    uint8_t crc = 0xFF, place, bit;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        crc = (uint8_t)(crc ^ codes[place]);
        for (bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc << 1) ^ ((crc & 0x80u) != 0 ? SKIN_CRC_8 : 0u));
        }
    }
    return crc;
}

void skin_pack_fine(const int32_t *steps, uint8_t check, uint8_t *payload)
{
    uint8_t place;

    memset(payload, 0, SKIN_GROUP_SUMS);
    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        skin_put_bits(payload, (uint16_t)(SKIN_FINE_BITS * place), (uint32_t)steps[place] & FINE_MASK, SKIN_FINE_BITS);
    }
    payload[SKIN_GROUP_SUMS - 1] = check;
}

double skin_fine_value(const uint8_t *payload, uint8_t place, int32_t near)
{
    const uint8_t bit = (uint8_t)(SKIN_FINE_BITS * place);
    const uint32_t two = payload[bit / 8u] | (uint32_t)payload[bit / 8u + 1u] << 8;
    int32_t away = (int32_t)(((two >> (bit % 8u)) - (uint32_t)near) & FINE_MASK);

    if (away >= SKIN_FINE_REACH) {
        away -= 2 * SKIN_FINE_REACH;
    }
    return (near + away) * SKIN_FINE_N;
}
