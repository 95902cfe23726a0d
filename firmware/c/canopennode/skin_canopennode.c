#include "skin_canopennode.h"

#include <stddef.h>

#include "301/CO_ODinterface.h"
#include "OD.h"
#include "board.h"
#include "skin_average.h"
#include "skin_sums.h"

#ifndef CO_LITTLE_ENDIAN
#error "the signature (2006h) reads values in the byte order of the bus: expected a little-endian processor"
#endif

#define LONGEST_TEXT 32

typedef ODR_t reader(OD_stream_t *, void *, OD_size_t, OD_size_t *);
typedef ODR_t writer(OD_stream_t *, const void *, OD_size_t, OD_size_t *);

static const skin_board *const board = &skin_boards[0];
static float *gain[SKIN_BLOCKS];
static int16_t *offset[SKIN_BLOCKS];
static uint8_t *pattern[SKIN_BLOCKS];
static void *sums[SKIN_BLOCKS]; /* raw values, of 8 or 16 bits */
static uint32_t *health;        /* 2020h: SYNCs received, TPDOs sent, TPDOs dropped, saturated taxels */
#if SKIN_SAMPLES > 1
static skin_average states[SKIN_BLOCKS];
#endif
static OD_extension_t signature_extension, gain_extension[SKIN_BLOCKS], pattern_extension[SKIN_BLOCKS];

static void *value_of(uint16_t index, uint8_t subindex, OD_size_t length)
{
    return OD_getPtr(OD_find(OD, index), subindex, length, NULL);
}

/* Read the configuration signature (2006h): CRC-32 over the values in use of the objects that it covers. */
static ODR_t read_signature(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead)
{
    uint8_t head[3], value[LONGEST_TEXT], place;
    uint32_t crc = 0;
    uint16_t each;

    if (stream == NULL || buf == NULL || countRead == NULL || count < sizeof crc) {
        return ODR_DEV_INCOMPAT;
    }
    for (each = 0; each < board->object_count; each++) {
        const skin_object *object = &board->objects[each];

        if ((object->flags & SKIN_OBJECT_COVERED) == 0) {
            continue;
        }
        if (object->bytes > sizeof value ||
            OD_get_value(OD_find(OD, object->index), object->subindex, value, object->bytes, false) != ODR_OK) {
            return ODR_GENERAL;
        }
        head[0] = (uint8_t)(object->index & 0xFFu);
        head[1] = (uint8_t)(object->index >> 8);
        head[2] = object->subindex;
        crc = skin_crc32(skin_crc32(crc, head, sizeof head), value, object->bytes);
    }
    for (place = 0; place < sizeof crc; place++) {
        ((uint8_t *)buf)[place] = (uint8_t)(crc >> (8 * place));
    }
    *countRead = sizeof crc;
    return ODR_OK;
}

/* Refuse a gain that is infinite or no number. */
static ODR_t write_gain(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    const uint8_t *data = buf;

    if (count == sizeof(float) && (data[3] & 0x7Fu) == 0x7Fu && (data[2] & 0x80u) != 0) {
        return ODR_INVALID_VALUE;
    }
    return OD_writeOriginal(stream, buf, count, countWritten);
}

static ODR_t write_pattern(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    if (count == 1 && *(const uint8_t *)buf > SKIN_PATTERN_FULL) {
        return ODR_INVALID_VALUE;
    }
    return OD_writeOriginal(stream, buf, count, countWritten);
}

/* Pass reads and writes of an object to functions; tell whether that failed. */
static int extend(OD_extension_t *extension, uint16_t index, reader *read, writer *write)
{
    extension->object = NULL;
    extension->read = read;
    extension->write = write;
    return OD_extension_init(OD_find(OD, index), extension) != ODR_OK;
}

int skin_app_init(void)
{
    int failed = extend(&signature_extension, SKIN_OD_SIGNATURE, read_signature, NULL);
    uint8_t block, place;

    health = value_of(SKIN_OD_HEALTH, 1, sizeof *health);
    failed |= health == NULL;
    for (block = 0; block < board->blocks; block++) {
        const uint16_t above = (uint16_t)(SKIN_OD_BLOCK_STRIDE * block);

        gain[block] = value_of((uint16_t)(SKIN_OD_GAIN + above), 1, sizeof *gain[0]);
        offset[block] = value_of((uint16_t)(SKIN_OD_OFFSET + above), 1, sizeof *offset[0]);
        pattern[block] = value_of((uint16_t)(SKIN_OD_PATTERN + above), 0, sizeof *pattern[0]);
        sums[block] = value_of((uint16_t)(SKIN_OD_SUMS + above), 1, board->packing.bits == 8 ? 1 : 2);
        failed |= gain[block] == NULL || offset[block] == NULL || pattern[block] == NULL || sums[block] == NULL;
        failed |= extend(&gain_extension[block], (uint16_t)(SKIN_OD_GAIN + above), OD_readOriginal, write_gain);
        failed |= extend(&pattern_extension[block], (uint16_t)(SKIN_OD_PATTERN + above), OD_readOriginal,
                         write_pattern);
        if (!failed) {
            *pattern[block] = SKIN_PATTERN_OFF;
        }
#if SKIN_SAMPLES > 1
        skin_forget(&states[block]);
#endif
    }
    for (place = 0; place < 4 && !failed; place++) {
        health[place] = 0;
    }
    return failed;
}

void skin_app_sync(uint16_t *counts, uint16_t samples)
{
    int32_t found[SKIN_SUMS];
    uint16_t each;
    uint8_t block;

    health[0]++;
    health[3] = 0;
    for (block = 0; block < board->blocks; block++) {
        health[3] += skin_measure(board, block, SKIN_AVERAGE_OF(states, block), counts, samples, gain[block],
                                  offset[block], *pattern[block], found);
        for (each = 0; each < board->first_sum[block + 1] - board->first_sum[block]; each++) {
            const int32_t raw = skin_raw(&board->packing, found[each]);

            if (board->packing.bits == 8) {
                ((uint8_t *)sums[block])[each] = (uint8_t)raw;
            } else {
                ((uint16_t *)sums[block])[each] = (uint16_t)raw;
            }
        }
    }
}

void skin_app_dropped(void)
{
    health[2]++;
}
