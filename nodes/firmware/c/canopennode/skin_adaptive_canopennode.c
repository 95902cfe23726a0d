#include "skin_canopennode.h"

#if SKIN_ADAPTIVE

#include <stddef.h>
#include <string.h>

#include "301/CO_ODinterface.h"
#include "OD.h"
#include "skin_od.h"
#include "skin_sender.h"
#include "skin_sums.h"

#define LONG_AGO (-((int64_t)1 << 60))

/* Objects that are answered, and taken, by functions. */
static const uint16_t indices[] = {SKIN_OD_REFRESH, SKIN_OD_SENDING, SKIN_OD_COEFFICIENT_NOISE, SKIN_OD_TAXEL_NOISE,
                                   SKIN_OD_BUDGET, SKIN_OD_NODE_NOISE, SKIN_OD_SUMS, SKIN_OD_COARSE, SKIN_OD_FINE};
#define INDICES (sizeof indices / sizeof indices[0])

static skin_sender sender;
static int64_t now_ns;
static uint8_t *coarse; /* 2110h */
static void *fine;      /* 2111h */
static uint8_t is_presented; /* whether they are those of the newest sample */
static OD_extension_t extensions[INDICES];

/* Put the codes of the newest sample where the stack reads them. */
static void present_codes(void)
{
    uint8_t of_sums[SKIN_BLOCK_SUMS];

    if (is_presented) {
        return;
    }
    is_presented = 1;
    skin_present_codes(&sender.groups, sender.filter.sums_n, coarse, of_sums);
    memcpy(fine, of_sums, sizeof of_sums);
}

static ODR_t read_value(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead)
{
    const uint8_t subindex = stream->subIndex, bytes = (uint8_t)stream->dataLength;
    uint32_t value;

    if (skin_sender_read(&sender, stream->index, subindex, &value)) {
        return skin_od_put(value, bytes, buf, count, countRead);
    }
    if (subindex > 0 && stream->index == SKIN_OD_SUMS) {
        value = (uint32_t)skin_raw(&skin_od_board->type->packing, skin_sender_sum(&sender, (uint8_t)(subindex - 1)));
        return skin_od_put(value, bytes, buf, count, countRead);
    }
    if (subindex > 0 && (stream->index == SKIN_OD_COARSE || stream->index == SKIN_OD_FINE)) {
        present_codes();
    }
    return OD_readOriginal(stream, buf, count, countRead);
}

static ODR_t write_value(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    const uint8_t subindex = stream->subIndex;
    uint32_t value = 0;
    ODR_t answer;

    if (count > sizeof value || count != stream->dataLength) {
        return OD_writeOriginal(stream, buf, count, countWritten); /* refuses it */
    }
    memcpy(&value, buf, count);
    if (!skin_sender_allows(stream->index, subindex, value)) {
        return ODR_INVALID_VALUE;
    }
    answer = OD_writeOriginal(stream, buf, count, countWritten);
    if (answer == ODR_OK) {
        skin_sender_write(&sender, stream->index, subindex, value);
    }
    return answer;
}

/* Read identifier and inhibit time of a TPDO, which SDO may have changed. */
static void configure(uint8_t number)
{
    const OD_entry_t *entry = OD_find(OD, (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number));
    uint32_t cob_id = 0;
    uint16_t inhibit = 0;

    (void)OD_get_value(entry, 1, &cob_id, sizeof cob_id, false);
    (void)OD_get_value(entry, 3, &inhibit, sizeof inhibit, false);
    skin_sender_configure(&sender, number, cob_id, inhibit);
}

/* Take a setting of four bytes from the dictionary. */
static void restore(uint16_t index, uint8_t subindex)
{
    uint32_t value = 0;

    if (OD_get_value(OD_find(OD, index), subindex, &value, sizeof value, true) == ODR_OK) {
        skin_sender_write(&sender, index, subindex, value);
    }
}

static void restore_all(void)
{
    uint8_t place;

    for (place = 1; place <= SKIN_RULE_ENTRIES; place++) {
        restore(SKIN_OD_SENDING, place);
    }
    for (place = 1; place <= SKIN_BLOCK_SUMS; place++) {
        restore(SKIN_OD_COEFFICIENT_NOISE, place);
        restore(SKIN_OD_TAXEL_NOISE, place);
    }
    restore(SKIN_OD_BUDGET, 0);
}

int skin_app_init(void)
{
    int failed = skin_od_connect();
    uint8_t each;

    memset(&sender, 0, sizeof sender);
    sender.board = skin_od_board;
    coarse = skin_od_value(SKIN_OD_COARSE, 1, sizeof *coarse);
    fine = skin_od_value(SKIN_OD_FINE, 1, SKIN_GROUP_SUMS);
    for (each = 0; each < INDICES; each++) {
        const int is_setting = indices[each] <= SKIN_OD_BUDGET && indices[each] >= SKIN_OD_REFRESH;

        failed |= skin_od_extend(&extensions[each], indices[each], read_value, is_setting ? write_value : NULL);
    }
    failed |= coarse == NULL || fine == NULL;
    if (!failed) {
        skin_app_reset();
    }
    return failed;
}

void skin_app_reset(void)
{
    uint8_t number;

    skin_od_reset();
    skin_sender_forget(&sender);
    sender.sync_ns = LONG_AGO;
    restore_all();
    for (number = 0; number < skin_od_board->type->tpdos; number++) {
        configure(number);
    }
}

int skin_app_sample(uint16_t *counts)
{
    const skin_block *block = &skin_od_blocks[0];

    is_presented = 0;
    skin_od_health[3] = skin_read_block(skin_od_board, counts, block->gain, block->offset, *block->pattern);
    memcpy(block->counts, counts, skin_od_board->type->block_size * sizeof counts[0]);
    return skin_sender_take(&sender, counts);
}

uint64_t skin_app_requests(int is_operational, int sync_was, int64_t passed_ns)
{
    uint8_t payload[2 * SKIN_GROUP_SUMS * SKIN_FD_GROUPS], group;
    uint64_t requests = 0;
    uint32_t period_us = 0;
    int urgent;

    now_ns += passed_ns;
    if (sync_was) {
        skin_od_health[0]++;
        sender.sync_ns = now_ns;
    }
    skin_sender_operate(&sender, is_operational != 0);
    skin_sender_decide(&sender, passed_ns);
    (void)OD_get_value(OD_find(OD, SKIN_OD_CYCLE_PERIOD_US), 0, &period_us, sizeof period_us, false);
    if (skin_sender_expiry(&sender, now_ns, (int64_t)period_us * 1000) == 0) {
        return 0;
    }
    for (group = 0; group < SKIN_GROUPS; group++) {
        if (sender.groups.groups[group].level != SKIN_NOT_DUE) {
            configure(skin_tpdo_of(&sender.groups, group));
        }
    }
    while ((urgent = skin_sender_most_urgent(&sender)) >= 0) {
        const uint8_t number = skin_tpdo_of(&sender.groups, (uint8_t)urgent);

        if (skin_sender_make(&sender, (uint8_t)urgent, payload) == 0) {
            break;
        }
        requests |= (uint64_t)1 << number;
    }
    if (requests != 0) {
        is_presented = 0; /* the check of fine codes is that of what was sent since */
        present_codes();
    }
    return requests;
}

void skin_app_sent(uint16_t identifier, uint8_t length, const uint8_t *data)
{
    if (skin_sender_sent(&sender, identifier, length, data)) {
        skin_od_health[1]++;
    }
}

void skin_app_given_up(uint16_t identifier, uint8_t length)
{
    (void)skin_sender_give_back(&sender, identifier, length);
}

void skin_app_refused(uint16_t identifier, uint8_t length)
{
    if (skin_sender_give_back(&sender, identifier, length)) {
        skin_od_health[2]++;
    }
}

#endif
