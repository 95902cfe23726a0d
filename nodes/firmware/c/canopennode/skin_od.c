#include "skin_od.h"

#include <stddef.h>
#include <string.h>

#include "OD.h"
#include "skin_canopennode.h"
#include "skin_sums.h"

#ifndef CO_LITTLE_ENDIAN
#error "the signature (2006h) reads values in the byte order of the bus: expected a little-endian processor"
#endif

#define LONGEST_TEXT 32

skin_block skin_od_blocks[SKIN_BLOCKS];
uint32_t *skin_od_health;
const skin_board *skin_od_board = &skin_boards[0];
static OD_extension_t signature_extension, calibration_extension;
static OD_extension_t gain_extension[SKIN_BLOCKS], pattern_extension[SKIN_BLOCKS];

void *skin_od_value(uint16_t index, uint8_t subindex, OD_size_t length)
{
    return OD_getPtr(OD_find(OD, index), subindex, length, NULL);
}

int skin_app_choose(uint8_t bus, uint8_t node_id)
{
    const skin_board *board = skin_board_of(bus, node_id);
    uint16_t each;

    if (board == NULL) {
        return 1;
    }
    skin_od_board = board;
    for (each = 0; each < board->type->object_count; each++) {
        const skin_object *object = &board->type->objects[each];

        if (skin_is_own(board->type, object->at)) {
            const uint8_t *own = skin_default(board, object->at);
            void *value = skin_od_value(object->index, object->subindex, object->bytes);

            if (value == NULL) {
                return 1;
            }
            if (memcmp(value, own, object->bytes) != 0) { /* what all boards share may be in flash memory */
                memcpy(value, own, object->bytes);
            }
        }
    }
    return 0;
}

int skin_od_extend(OD_extension_t *extension, uint16_t index, skin_od_reader *read, skin_od_writer *write)
{
    extension->object = NULL;
    extension->read = read;
    extension->write = write;
    if (OD_extension_init(OD_find(OD, index), extension) != ODR_OK) {
        return 1;
    }
#if OD_FLAGS_PDO_SIZE > 0
    memset(extension->flagsPDO, 0xFF, sizeof extension->flagsPDO); /* a bit of 0 has the stack send what maps the object */
#endif
    return 0;
}

ODR_t skin_od_put(uint64_t value, uint8_t bytes, void *buf, OD_size_t count, OD_size_t *countRead)
{
    uint8_t place;

    if (buf == NULL || countRead == NULL || count < bytes) {
        return ODR_DEV_INCOMPAT;
    }
    for (place = 0; place < bytes; place++) {
        ((uint8_t *)buf)[place] = (uint8_t)(value >> (8 * place));
    }
    *countRead = bytes;
    return ODR_OK;
}

/* Read a signature (2006h, 2009h): CRC-32 over the values in use of the objects with one of the flags of the extension. */
static ODR_t read_signature(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead)
{
    uint8_t head[3], value[LONGEST_TEXT];
    uint32_t crc = 0;
    const uint8_t flags = *(const uint8_t *)stream->object;
    uint16_t each;

    for (each = 0; each < skin_od_board->type->object_count; each++) {
        const skin_object *object = &skin_od_board->type->objects[each];

        if ((object->flags & flags) == 0) {
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
    return skin_od_put(crc, sizeof crc, buf, count, countRead);
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

/* Refuse a byte above the one that the object of the extension is. */
static ODR_t write_choice(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    if (count == 1 && *(const uint8_t *)buf > *(const uint8_t *)stream->object) {
        return ODR_INVALID_VALUE;
    }
    return OD_writeOriginal(stream, buf, count, countWritten);
}

/* Connect gains, offsets and counts of a block. */
static int connect_taxels(uint8_t number)
{
    const uint16_t above = (uint16_t)(SKIN_BLOCK_STRIDE * number);
    skin_block *block = &skin_od_blocks[number];

    block->gain = skin_od_value((uint16_t)(SKIN_OD_GAIN + above), 1, sizeof *block->gain);
    block->offset = skin_od_value((uint16_t)(SKIN_OD_OFFSET + above), 1, sizeof *block->offset);
    block->counts = skin_od_value((uint16_t)(SKIN_OD_COUNTS + above), 1, sizeof *block->counts);
    return block->gain == NULL || block->offset == NULL || block->counts == NULL ||
           skin_od_extend(&gain_extension[number], (uint16_t)(SKIN_OD_GAIN + above), OD_readOriginal, write_gain);
}

int skin_od_connect(void)
{
    static uint8_t covered = SKIN_OBJECT_COVERED, calibrated = SKIN_OBJECT_COVERED | SKIN_OBJECT_CALIBRATING;
    static uint8_t last_pattern = SKIN_PATTERN_FULL;
    int failed = skin_od_extend(&signature_extension, SKIN_OD_SIGNATURE, read_signature, NULL);
    uint8_t each;

    signature_extension.object = &covered;
    skin_od_health = skin_od_value(SKIN_OD_HEALTH, 1, sizeof *skin_od_health);
    failed |= skin_od_health == NULL;
    if (!SKIN_ANALOGUE) {
        failed |= skin_od_extend(&calibration_extension, SKIN_OD_CALIBRATION_SIGNATURE, read_signature, NULL);
        calibration_extension.object = &calibrated;
    }
    for (each = 0; each < skin_od_board->type->blocks; each++) {
        const uint16_t index = (uint16_t)(SKIN_OD_TEST_PATTERN + SKIN_BLOCK_STRIDE * each);

        skin_od_blocks[each].pattern = skin_od_value(index, 0, 1);
        failed |= skin_od_blocks[each].pattern == NULL;
        failed |= skin_od_extend(&pattern_extension[each], index, OD_readOriginal, write_choice);
        pattern_extension[each].object = &last_pattern;
        failed |= !SKIN_ANALOGUE && connect_taxels(each);
    }
    return failed;
}

void skin_od_reset(void)
{
    uint8_t each;

    for (each = 0; each < skin_od_board->type->blocks; each++) {
        *skin_od_blocks[each].pattern = SKIN_PATTERN_OFF;
    }
    for (each = 0; each < 4; each++) {
        skin_od_health[each] = 0;
    }
}
