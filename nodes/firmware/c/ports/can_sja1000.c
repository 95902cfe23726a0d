/* SJA1000 in PeliCAN mode (NXP, SJA1000 data sheet): one transmit buffer, 64 bytes of receive FIFO. */
#include "port.h"

enum { MODE = 0, COMMAND = 1, STATUS = 2, INTERRUPT = 3, ENABLE = 4, TIMING_0 = 6, TIMING_1 = 7, OUTPUT = 8, CODE = 16, MASK = 20, FRAME = 16, CLOCK = 31 };
enum { RESET_MODE = 1 };
enum { TRANSMIT = 1, ABORT = 2, RELEASE = 4, CLEAR_OVERRUN = 8 };
enum { RECEIVED = 1, TRANSMITTED = 2, ERROR_WARNING = 4, OVERRUN = 8 }; /* interrupts */
enum { HAS_FRAME = 1, IS_COMPLETE = 8, BUS_OFF = 0x80 };
enum { REMOTE = 0x40, EXTENDED = 0x80, LENGTH = 0x0F }; /* frame information */
enum { PELICAN = 0xC0, PUSH_PULL = 0xDA };
/* Quanta of a bit: 1 + 5 + 2, sampled at 75 %. */
enum { QUANTA = 8, SEGMENTS = 4 | 1 << 4 };
#define FIFO_BYTES 64

static volatile uint8_t *controller;

void can_open(uintptr_t base, uint32_t clock_hz)
{
    int each;

    controller = (volatile uint8_t *)base;
    controller[CLOCK] = PELICAN;
    controller[MODE] = RESET_MODE;
    for (each = 0; each < FIFO_BYTES; each++) { /* what came before a restart of the processor alone */
        controller[COMMAND] = RELEASE;
    }
    controller[OUTPUT] = PUSH_PULL;
    controller[TIMING_0] = (uint8_t)(clock_hz / 2 / QUANTA / SKIN_BITRATE - 1);
    controller[TIMING_1] = SEGMENTS;
    for (each = 0; each < 4; each++) { /* take all identifiers */
        controller[CODE + each] = 0;
        controller[MASK + each] = 0xFF;
    }
    controller[ENABLE] = RECEIVED | TRANSMITTED | ERROR_WARNING | OVERRUN;
    (void)controller[INTERRUPT];
    controller[MODE] = 0; /* two filters */
}

static void receive(void)
{
    const uint8_t information = controller[FRAME];
    skin_frame frame = {0};
    int each;

    frame.can_id = (uint32_t)controller[FRAME + 1] << 3 | controller[FRAME + 2] >> 5;
    frame.length = (information & LENGTH) > 8 ? 8 : information & LENGTH;
    for (each = 0; each < frame.length; each++) {
        frame.data[each] = controller[FRAME + 3 + each];
    }
    controller[COMMAND] = RELEASE;
    if ((information & (REMOTE | EXTENDED)) == 0) {
        port_received(&frame);
    }
}

void can_interrupt(void)
{
    const uint8_t causes = controller[INTERRUPT]; /* reading clears all but RECEIVED */

    if ((causes & OVERRUN) != 0) {
        port_count.lost++;
        controller[COMMAND] = CLEAR_OVERRUN;
    }
    while ((controller[STATUS] & HAS_FRAME) != 0) {
        receive();
    }
    if ((causes & TRANSMITTED) != 0) {
        port_transmitted((controller[STATUS] & IS_COMPLETE) != 0);
    }
    if ((causes & ERROR_WARNING) != 0 && (controller[STATUS] & BUS_OFF) != 0) {
        controller[MODE] = 0; /* back after 128 times 11 recessive bits (ISO 11898-1) */
        port_transmitted(0);
    }
}

void can_transmit(const skin_frame *frame)
{
    int each;

    controller[FRAME] = frame->length;
    controller[FRAME + 1] = (uint8_t)(frame->can_id >> 3);
    controller[FRAME + 2] = (uint8_t)(frame->can_id << 5);
    for (each = 0; each < frame->length; each++) {
        controller[FRAME + 3 + each] = frame->data[each];
    }
    controller[COMMAND] = TRANSMIT;
}

void can_abort(void)
{
    controller[COMMAND] = ABORT; /* TRANSMITTED comes, with IS_COMPLETE if the frame was on the bus already */
}
