/* CTU CAN FD (Czech Technical University in Prague, data sheet of the IP core): of its transmit buffers the first. */
#include "port.h"

enum { MODE = 0x04, STATUS = 0x08, COMMAND = 0x0C, INTERRUPT = 0x10, ENABLE = 0x14, TIMING = 0x24, DATA_TIMING = 0x28,
       FAULT = 0x2C, RECEIVED_WORD = 0x6C, BUFFER_STATE = 0x70, BUFFER_COMMAND = 0x74, PRIORITY = 0x78, DELAY = 0x80, BUFFER = 0x100 };
enum { RESET = 1, FD_ENABLED = 1 << 4, ENABLED = 1 << 22 };
enum { HAS_FRAME = 1, CLEAR_OVERRUN = 1 << 3, RECOVER = 1 << 4, BUS_OFF = 1 << 18 };
enum { RECEIVED = 1, OVERRUN = 1 << 3, FAULT_CHANGED = 1 << 4, BUFFER_DONE = 1 << 11 }; /* interrupts */
enum { SENT = 4, SET_READY = 1 << 1, SET_ABORTED = 1 << 2, FIRST = 1 << 8 };
/* The first word of a frame; the identifier and two words of time stamp follow, then data. */
enum { DLC = 0x0F, REMOTE = 1 << 5, EXTENDED = 1 << 6, FD = 1 << 7, RATE_SWITCHED = 1 << 9, WORDS_AT = 11, WORDS = 0x1F, HEAD_WORDS = 3 };
#define IDENTIFIER_AT 18

static const uint8_t lengths[] = SKIN_FD_LENGTHS;
static uintptr_t controller;

static uint32_t get(uint32_t place)
{
    return *(volatile uint32_t *)(controller + place);
}

static void put(uint32_t place, uint32_t value)
{
    *(volatile uint32_t *)(controller + place) = value;
}

/* A bit of `quanta` clocks, sampled at 75 %: the segment behind the sample point is as long as the one before, and as the
 * longest resynchronisation.
 */
static uint32_t segments(uint32_t quanta)
{
    const uint32_t phase = quanta / 4;

    return (quanta - 1 - 2 * phase) | phase << 7 | phase << 13 | 1u << 19 | phase << 27;
}

void can_open(uintptr_t base, uint32_t clock_hz)
{
    controller = base;
    put(MODE, RESET);
    put(TIMING, segments(clock_hz / SKIN_BITRATE));
#ifdef SKIN_DATA_BITRATE
    put(DATA_TIMING, segments(clock_hz / SKIN_DATA_BITRATE));
    put(DELAY, clock_hz / SKIN_DATA_BITRATE * 3 / 4 << 16); /* compensated: as measured, and on to the sample point */
#endif
    put(PRIORITY, 1);
    put(ENABLE, RECEIVED | OVERRUN | FAULT_CHANGED | BUFFER_DONE);
    put(MODE, ENABLED | FD_ENABLED);
}

static void receive(void)
{
    const uint32_t form = get(RECEIVED_WORD), words = (form >> WORDS_AT & WORDS) - HEAD_WORDS;
    skin_frame frame = {0};
    uint32_t at, word, each;

    frame.can_id = get(RECEIVED_WORD) >> IDENTIFIER_AT & SKIN_BASE_ID_MASK;
    (void)get(RECEIVED_WORD);
    (void)get(RECEIVED_WORD);
    for (at = 0; at < 4 * words; at += 4) {
        word = get(RECEIVED_WORD);
        for (each = 0; each < 4 && at + each < SKIN_FRAME_BYTES; each++) {
            frame.data[at + each] = (uint8_t)(word >> 8 * each);
        }
    }
    frame.length = lengths[form & DLC];
    if ((form & FD) != 0) {
        frame.flags = SKIN_FRAME_FD;
    } else if (frame.length > 8) {
        frame.length = 8;
    }
    if ((form & (REMOTE | EXTENDED)) == 0 && frame.length <= SKIN_FRAME_BYTES) {
        port_received(&frame);
    }
}

void can_interrupt(void)
{
    const uint32_t causes = get(INTERRUPT);

    put(INTERRUPT, causes);
    if ((causes & OVERRUN) != 0) {
        port_count.lost++;
        put(COMMAND, CLEAR_OVERRUN);
    }
    while ((get(STATUS) & HAS_FRAME) != 0) {
        receive();
    }
    if ((causes & BUFFER_DONE) != 0) {
        port_transmitted((get(BUFFER_STATE) & 0x0F) == SENT);
    }
    if ((causes & FAULT_CHANGED) != 0 && (get(FAULT) & BUS_OFF) != 0) {
        put(COMMAND, RECOVER); /* back after 128 times 11 recessive bits (ISO 11898-1) */
    }
}

void can_transmit(const skin_frame *frame)
{
    const uint32_t words = (frame->length + 3u) / 4u;
    uint32_t form = (HEAD_WORDS + words) << WORDS_AT, at, word, each;

    while (lengths[form & DLC] < frame->length) {
        form++;
    }
    form |= (frame->flags & SKIN_FRAME_FD) != 0 ? FD : 0;
    form |= (frame->flags & SKIN_FRAME_BRS) != 0 ? RATE_SWITCHED : 0;
    put(BUFFER, form);
    put(BUFFER + 4, frame->can_id << IDENTIFIER_AT);
    put(BUFFER + 8, 0); /* earliest time */
    put(BUFFER + 12, 0);
    for (at = 0; at < 4 * words; at += 4) {
        word = 0;
        for (each = 0; each < 4; each++) {
            word |= at + each < frame->length ? (uint32_t)frame->data[at + each] << 8 * each : 0;
        }
        put(BUFFER + 16 + at, word);
    }
    put(BUFFER_COMMAND, SET_READY | FIRST);
}

void can_abort(void)
{
    put(BUFFER_COMMAND, SET_ABORTED | FIRST); /* BUFFER_DONE comes, also if the frame was on the bus already */
}
