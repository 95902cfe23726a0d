/* A stepped board behind the functions that CANopenNode has for dictionaries. Reads a line for each sample: what becomes of
 * frames, what is written to 2030h, the counter of a SYNC or 0, and the counts. Prints a line for each: identifier and data of
 * every frame. The samples until the board is ready make no line; then it prints the signature (2006h) and its noise (2035h).
 */
#include <stdio.h>
#include <string.h>

#include "301/CO_ODinterface.h"
#include "OD.h"
#include "skin_canopennode.h"

enum { FREE, LOST, HELD };
static uint8_t held; /* TPDOs whose frames wait */

static int read_sample(unsigned *fate, unsigned *is_asked, unsigned *counter, uint16_t *counts)
{
    unsigned value, place;

    if (scanf("%u %u %u", fate, is_asked, counter) != 3) {
        return 0;
    }
    for (place = 0; place < SKIN_BLOCK_SIZE; place++) {
        if (scanf("%u", &value) != 1) {
            return 0;
        }
        counts[place] = (uint16_t)value;
    }
    return 1;
}

static uint32_t read_object(uint16_t index, uint8_t sub)
{
    uint32_t value = 0;

    if (OD_get_value(OD_find(OD, index), sub, &value, sizeof value, false) != ODR_OK) {
        printf("%04X cannot be read\n", index);
    }
    return value;
}

/* Tell whether an object has the stack send TPDOs by itself. */
static int is_flagged(uint16_t index)
{
    const OD_extension_t *extension = OD_find(OD, index)->extension;
    unsigned each, clear = 0;

    for (each = 0; extension != NULL && each < sizeof extension->flagsPDO; each++) {
        clear |= 0xFFu ^ extension->flagsPDO[each];
    }
    return clear != 0;
}

/* Collect the mapped objects of a TPDO, as the stack does; returns the number of bytes. */
static unsigned map(unsigned number, uint8_t *data)
{
    const OD_entry_t *mapping = OD_find(OD, (uint16_t)(0x1A00 + number));
    static const uint8_t lengths[] = SKIN_FD_LENGTHS;
    unsigned length = 0, each, place = 0;
    uint8_t count = 0;

    OD_get_value(mapping, 0, &count, 1, false);
    for (each = 1; each <= count; each++) {
        uint32_t mapped = 0;

        OD_get_value(mapping, (uint8_t)each, &mapped, sizeof mapped, false);
        OD_get_value(OD_find(OD, (uint16_t)(mapped >> 16)), (uint8_t)(mapped >> 8 & 0xFFu), &data[length],
                     (mapped & 0xFFu) / 8u, false);
        if (is_flagged((uint16_t)(mapped >> 16))) {
            printf(" requested by a flag");
        }
        length += (mapped & 0xFFu) / 8u;
    }
    while (lengths[place] < length) {
        place++;
    }
    return lengths[place];
}

static void send(unsigned number, unsigned fate)
{
    const uint16_t identifier = (uint16_t)(read_object((uint16_t)(0x1800 + number), 1) & 0x7FFu);
    uint8_t data[64] = {0};
    const unsigned length = map(number, data);
    unsigned each;

    printf(" %u:", identifier);
    for (each = 0; each < length; each++) {
        printf("%02x", data[each]);
    }
    if (fate == LOST) {
        skin_app_dropped((uint8_t)number);
    } else if (fate == HELD) {
        held = (uint8_t)(held | 1u << number);
    }
}

int main(void)
{
    uint16_t counts[SKIN_BLOCK_SIZE];
    uint8_t order = 1;
    unsigned fate, is_asked, counter, number, is_ready = 0;

    if (skin_app_init()) {
        printf("the dictionary lacks an object\n");
        return 1;
    }
    while (read_sample(&fate, &is_asked, &counter, counts)) {
        if (!is_ready) {
            is_ready = skin_app_sample(counts) != 0;
            if (is_ready) {
                skin_app_reset();
                printf("%u %u\n", read_object(0x2006, 0), read_object(0x2035, 0));
            }
            continue;
        }
        if (is_asked) {
            OD_set_value(OD_find(OD, 0x2030), 0, &order, 1, false);
        }
        skin_app_sample(counts);
        const uint8_t requests = skin_app_requests(1, (uint8_t)counter, 1000000, held);
        for (number = 0; number < OD_CNT_TPDO; number++) {
            if ((requests >> number & 1u) != 0) {
                send(number, fate);
            }
        }
        held = fate == HELD ? held : 0;
        printf("\n");
    }
    return 0;
}
