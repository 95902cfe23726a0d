#include "skin_canopennode.h"

#if SKIN_STEPPED

#include <stddef.h>
#include <string.h>

#include "301/CO_ODinterface.h"
#include "OD.h"
#include "skin_od.h"
#include "skin_steps.h"
#include "skin_sums.h"

/* Objects that are answered, and taken, by functions: the first SETTINGS are settings. */
static const uint16_t indices[] = {SKIN_OD_REFRESH,    SKIN_OD_SENDING, SKIN_OD_COEFFICIENT_NOISE, SKIN_OD_TAXEL_NOISE,
                                   SKIN_OD_NODE_NOISE, SKIN_OD_SUMS};
#define INDICES (sizeof indices / sizeof indices[0])
#define SETTINGS 4

static skin_steps steps;
static int64_t now_ns;
static uint8_t *slot_byte; /* 2022h */
static void *words;        /* 2110h */
static OD_extension_t extensions[INDICES];

static ODR_t read_value(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead)
{
    const uint8_t subindex = stream->subIndex, bytes = (uint8_t)stream->dataLength;
    uint64_t value;

    if (skin_steps_read(&steps, stream->index, subindex, &value)) {
        return skin_od_put(value, bytes, buf, count, countRead);
    }
    if (subindex > 0 && stream->index == SKIN_OD_SUMS) {
        const int32_t sum = skin_filter_sum(&steps.filter, skin_od_board, (uint8_t)(subindex - 1));

        return skin_od_put((uint32_t)skin_raw(&skin_od_board->type->packing, sum), bytes, buf, count, countRead);
    }
    return OD_readOriginal(stream, buf, count, countRead);
}

static ODR_t write_value(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    uint32_t value = 0;
    ODR_t answer;

    if (count > sizeof value || count != stream->dataLength) {
        return OD_writeOriginal(stream, buf, count, countWritten); /* refuses it */
    }
    memcpy(&value, buf, count);
    if (!skin_steps_allow(stream->index, stream->subIndex, value)) {
        return ODR_INVALID_VALUE;
    }
    answer = OD_writeOriginal(stream, buf, count, countWritten);
    if (answer == ODR_OK) {
        skin_steps_write(&steps, stream->index, stream->subIndex, value);
    }
    return answer;
}

/* Take the settings from the dictionary. */
static void restore(void)
{
    const skin_type *type = skin_od_board->type;
    uint16_t place;
    uint8_t each;

    for (place = 0; place < type->object_count; place++) {
        const skin_object *object = &type->objects[place];
        uint32_t value = 0;

        for (each = 1; each < SETTINGS; each++) { /* 2030h is an order */
            if (object->index == indices[each] && object->subindex > 0 &&
                OD_get_value(OD_find(OD, object->index), object->subindex, &value, object->bytes, true) == ODR_OK) {
                skin_steps_write(&steps, object->index, object->subindex, value);
            }
        }
    }
}

int skin_app_init(void)
{
    int failed = skin_od_connect();
    uint8_t each;

    memset(&steps, 0, sizeof steps);
    steps.board = skin_od_board;
    slot_byte = skin_od_value(SKIN_OD_SYNC_COUNTER, 0, sizeof *slot_byte);
    words = skin_od_value(SKIN_OD_WORDS, 1, SKIN_WORD_BYTES);
    for (each = 0; each < INDICES; each++) {
        failed |= skin_od_extend(&extensions[each], indices[each], read_value, each < SETTINGS ? write_value : NULL);
    }
    failed |= slot_byte == NULL || words == NULL;
    if (!failed) {
        skin_app_reset();
    }
    return failed;
}

/* Put the words where the stack reads them, in elements of 64 bits, behind the slot of a TPDO. */
static void present(uint8_t number)
{
    uint8_t payload[SKIN_PDO_BYTES];

    (void)skin_steps_payload(&steps, number, payload);
    *slot_byte = steps.ways[number].slot < 0 ? 0 : payload[0];
    memcpy(words, steps.word, skin_od_board->type->frame_parts * skin_od_board->type->tpdos * sizeof steps.word[0]);
}

void skin_app_reset(void)
{
    skin_od_reset();
    skin_steps_forget(&steps);
    restore();
    present(0);
}

int skin_app_sample(uint16_t *counts)
{
    const skin_block *block = &skin_od_blocks[0];

    skin_od_health[3] = skin_read_block(skin_od_board, counts, block->gain, block->offset, *block->pattern);
    memcpy(block->counts, counts, skin_od_board->type->block_size * sizeof counts[0]);
    return skin_steps_take(&steps, counts, *block->pattern);
}

uint8_t skin_app_requests(int is_operational, uint8_t counter, int64_t passed_ns, uint8_t held)
{
    uint8_t number, type = 0, chosen;

    now_ns += passed_ns;
    if (counter != 0) {
        skin_od_health[0]++;
        skin_steps_sync(&steps, counter, now_ns);
    }
    for (number = 0; number < skin_od_board->type->tpdos; number++) {
        uint32_t cob_id = 0;

        (void)OD_get_value(OD_find(OD, (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number)), 1, &cob_id, sizeof cob_id, false);
        steps.ways[number].cob_id = (uint16_t)((cob_id & SKIN_COB_ID_INVALID) != 0 ? 0 : cob_id & SKIN_BASE_ID_MASK);
        steps.ways[number].held_until_ns = (held >> number & 1u) != 0 ? now_ns + 1 : 0;
    }
    skin_steps_operate(&steps, is_operational != 0);
    (void)OD_get_value(OD_find(OD, SKIN_OD_TPDO_COMMUNICATION), 2, &type, sizeof type, false);
    if (type <= SKIN_LAST_SYNCHRONOUS && counter == 0) {
        return 0; /* the stack would not send the words now, and later ones at the SYNC */
    }
    chosen = skin_steps_choose(&steps, now_ns);
    for (number = 0; number < skin_od_board->type->tpdos; number++) {
        if ((chosen >> number & 1u) != 0) {
            skin_od_health[1]++;
            present(number); /* both are of the same slot */
        }
    }
    return chosen;
}

void skin_app_dropped(uint8_t tpdo)
{
    skin_steps_done(&steps, tpdo, 0);
    skin_od_health[2]++;
}

#endif
