/* One board of an image behind the slave, or with BEHIND_STACK behind the functions of CANopenNode: arguments are the number of the
 * bus, the node-ID and the number of turns. Reads a test pattern, the counter of a SYNC, and then count, bits of the gain and offset
 * of each place, of analogue boards the first two alone; prints the frames that answer a SYNC of each turn, a line for each reading.
 */
#include <stdio.h>
#include <stdlib.h>

#ifdef BEHIND_STACK
#include "skin_canopennode.h"
#include "skin_od.h"

#include "OD.h"
#else
#include "skin_node.h"
#endif

static void print_frame(unsigned can_id, const uint8_t *data, unsigned length)
{
    unsigned byte;

    printf("%u:", can_id);
    for (byte = 0; byte < length; byte++) {
        printf("%02x", data[byte]);
    }
    printf(" ");
}

#ifdef BEHIND_STACK

static void write_object(uint16_t index, uint8_t subindex, uint32_t value, uint8_t bytes)
{
    if (OD_set_value(OD_find(OD, index), subindex, &value, bytes, false) != ODR_OK) {
        printf("%04X:%u is refused ", (unsigned)index, subindex);
    }
}

static uint32_t read_object(uint16_t index, uint8_t subindex, uint8_t bytes)
{
    uint32_t value = 0;

    if (OD_get_value(OD_find(OD, index), subindex, &value, bytes, false) != ODR_OK) {
        printf("%04X:%u is missing ", (unsigned)index, subindex);
    }
    return value;
}

static int start(uint8_t bus, uint8_t node_id)
{
    return skin_app_choose(bus, node_id) || skin_app_init();
}

/* Print what CO_process_TPDO sends: every TPDO that the adapter lets go. */
static void answer(skin_reading *readings, uint8_t counter)
{
    static const uint8_t fd_lengths[] = SKIN_FD_LENGTHS;
    uint8_t tpdo, place, length;

    skin_app_sync(readings, 1, counter);
    for (tpdo = 0; tpdo < OD_CNT_TPDO; tpdo++) {
        const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + tpdo);
        const uint16_t mapping = (uint16_t)(SKIN_OD_TPDO_MAPPING + tpdo);
        uint8_t data[64] = {0};
        uint16_t bits = 0;

        for (place = 1; place <= read_object(mapping, 0, 1); place++) {
            const uint32_t entry = read_object(mapping, place, 4), width = entry & 0xFFu;

            skin_put_bits(data, bits, read_object((uint16_t)(entry >> 16), (uint8_t)(entry >> 8), (uint8_t)((width + 7) / 8)),
                          (uint8_t)width);
            bits = (uint16_t)(bits + width);
        }
        for (length = 0; fd_lengths[length] < (bits + 7) / 8; length++) {
        }
        if (skin_is_turn((uint8_t)read_object(communication, 2, 1), (uint8_t)read_object(communication, 6, 1), counter)) {
            print_frame(read_object(communication, 1, 4) & SKIN_BASE_ID_MASK, data, fd_lengths[length]);
        }
    }
}

#else

static skin_node node;
static skin_frame sent[256];
static skin_outbox outbox = {sent, 256, 0};

static void write_object(uint16_t index, uint8_t subindex, uint32_t value, uint8_t bytes)
{
    uint8_t data[4];

    skin_put(data, value, bytes);
    if (skin_write(&node, index, subindex, data, bytes) != 0) {
        printf("%04X:%u is refused ", (unsigned)index, subindex);
    }
}

static uint32_t read_object(uint16_t index, uint8_t subindex, uint8_t bytes)
{
    (void)bytes;
    return skin_unsigned(&node, index, subindex);
}

static int start(uint8_t bus, uint8_t node_id)
{
    const skin_frame command = {.length = 2, .data = {SKIN_NMT_START, 0}};
    const skin_board *board = skin_board_of(bus, node_id);

    if (board == NULL) {
        return 1;
    }
    skin_init(&node, board, &outbox, NULL);
    skin_boot(&node, 0, 0);
    skin_nmt(&node, &command, 0);
    outbox.count = 0;
    return 0;
}

static void answer(skin_reading *readings, uint8_t counter)
{
    const skin_frame sync = {.length = 1, .data = {counter}};
    size_t each;

    skin_sync(&node, &sync, readings, 1);
    for (each = 0; each < outbox.count; each++) {
        print_frame(sent[each].can_id, sent[each].data, sent[each].length);
    }
    outbox.count = 0;
}

#endif

/* Read counts and calibration of all places; tell whether they were there. */
static int has_read(skin_reading *counts)
{
    unsigned place, x, gain;
    int offset;

    for (place = 0; !SKIN_ANALOGUE && place < SKIN_READINGS; place++) {
        const uint16_t above = (uint16_t)(SKIN_BLOCK_STRIDE * (place / SKIN_BLOCK_SIZE));
        const uint8_t subindex = (uint8_t)(place % SKIN_BLOCK_SIZE + 1);

        if (scanf("%u %u %d", &x, &gain, &offset) != 3) {
            return 0;
        }
        counts[place] = (skin_reading)x;
        write_object((uint16_t)(SKIN_OD_GAIN + above), subindex, gain, 4);
        write_object((uint16_t)(SKIN_OD_OFFSET + above), subindex, (uint32_t)offset, 2);
    }
    return 1;
}

int main(int count, char **texts)
{
    skin_reading counts[SKIN_READINGS] = {0}, read[SKIN_READINGS];
    unsigned pattern, counter, place, turn, turns;

    if (count != 4 || start((uint8_t)atoi(texts[1]), (uint8_t)atoi(texts[2])) != 0) {
        return 1;
    }
    printf("%u\n", (unsigned)read_object(SKIN_OD_SIGNATURE, 0, 4));
    turns = (unsigned)atoi(texts[3]);
    while (scanf("%u %u", &pattern, &counter) == 2 && has_read(counts)) {
        for (place = 0; place < SKIN_BLOCKS; place++) {
            write_object((uint16_t)(SKIN_OD_TEST_PATTERN + SKIN_BLOCK_STRIDE * place), 0, pattern, 1);
        }
        for (turn = 0; turn < turns; turn++) {
            for (place = 0; place < SKIN_READINGS; place++) {
                read[place] = counts[place];
            }
            answer(read, (uint8_t)(counter + turn));
        }
        printf("\n");
    }
    return 0;
}
