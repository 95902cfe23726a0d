/* One board: the CANopen slave over a port. */
#include <string.h>

#include "port.h"

#define MILLISECOND_NS 1000000
/* Frames of one call into the slave: all TPDOs, and an answer, a heartbeat and emergencies. */
#define POSTED (SKIN_TPDOS + 8)

static skin_node node;
static skin_frame posted[POSTED];
static skin_outbox outbox = {posted, POSTED, 0};
static skin_storage storage;
static volatile uint8_t own_node_id;

/* Two conversions: the next SYNC may come while the main loop still has the readings of the last. */
static skin_reading readings[2][SKIN_SAMPLES * SKIN_READINGS];
#if !SKIN_STEPPED
static uint16_t samples[2];
static volatile uint32_t converted, answered;
#endif

/* Interrupt: of the frames that a board heeds, a SYNC starts the converters at once. */
void port_received(skin_frame *frame)
{
    const uint32_t can_id = frame->can_id;

    frame->time_ns = port_now_ns();
#if !SKIN_STEPPED
    if (can_id == SKIN_SYNC_COB_ID) {
        if (converted - answered == 2) {
            port_count.lost++;
        } else {
            samples[converted % 2] = port_convert(frame, readings[converted % 2]);
            converted += (uint32_t)queue_put(frame);
        }
        return;
    }
#endif
    if (can_id == SKIN_NMT_COB_ID || can_id == SKIN_SYNC_COB_ID || can_id == SKIN_LSS_REQUEST_COB_ID ||
        can_id == (uint32_t)SKIN_SDO_REQUEST_BASE + own_node_id ||
        (SKIN_HEARTBEAT_BASE < can_id && can_id <= SKIN_HEARTBEAT_BASE + SKIN_HIGHEST_NODE_ID)) {
        (void)queue_put(frame);
    }
}

static void flush(void)
{
    size_t each;

    for (each = 0; each < outbox.count; each++) {
        if (!queue_send(&posted[each])) {
            skin_refused(&node, &posted[each]);
        }
    }
    outbox.count = 0;
}

static uint32_t now_ms(void)
{
    return (uint32_t)(port_now_ns() / MILLISECOND_NS);
}

static void heed(const skin_frame *frame)
{
    const uint32_t can_id = frame->can_id;

    if (can_id == SKIN_SYNC_COB_ID) {
#if SKIN_STEPPED
        skin_sync(&node, frame);
#else
        skin_sync(&node, frame, readings[answered % 2], samples[answered % 2]);
        answered++;
#endif
    } else if (can_id == SKIN_NMT_COB_ID) {
        skin_nmt(&node, frame, now_ms());
    } else if (can_id == SKIN_LSS_REQUEST_COB_ID) {
        skin_lss_request(&node, frame, now_ms());
    } else if (can_id > SKIN_HEARTBEAT_BASE) {
        skin_heard(&node, (uint8_t)(can_id - SKIN_HEARTBEAT_BASE), now_ms());
    } else if (frame->length == SKIN_SDO_BYTES) {
        skin_request(&node, frame, now_ms());
    }
}

static void heed_outcomes(void)
{
    skin_frame frame;

    while (queue_outcome(&frame)) {
        if (frame.flags == SKIN_FRAME_DISCARDED) {
            skin_given_up(&node, &frame);
#if SKIN_STEPPED
        } else {
            skin_sent(&node, &frame);
#endif
        }
    }
}

static const skin_board *own_board(void)
{
    const skin_board *board = skin_board_of(port_bus(), port_node_id());
    uint32_t each;

    for (each = 0; board == NULL && port_node_id() == 0 && each < SKIN_BOARDS; each++) {
        board = skin_boards[each].bus == port_bus() ? &skin_boards[each] : NULL;
    }
    return board;
}

/* What is due each millisecond; tell whether the board has booted. */
static int tick(int has_booted)
{
#if SKIN_STEPPED
    (void)port_convert(NULL, readings[0]);
    if (!skin_sample(&node, readings[0])) {
        return 0; /* the board learns its noise */
    }
#endif
    if (!has_booted && port_node_id() == 0) {
        skin_lss_boot(&node, now_ms());
    } else if (!has_booted) {
        skin_boot(&node, now_ms(), 0);
    }
#if SKIN_STEPPED
    skin_send_sums(&node, port_now_ns());
#endif
    skin_tick(&node, now_ms());
    queue_tick(port_now_ns());
    return 1;
}

int main(void)
{
    int has_booted = 0;
    uint32_t ticked_ms = 0;
    skin_frame frame;

    port_open();
    while (own_board() == NULL) { /* not of this image: stay off the bus */
        port_alive();
    }
    storage = skin_slots(&port_records);
    skin_init(&node, own_board(), &outbox, &storage);
    skin_program_init(&node, &port_programs, port_slot());
    node.serial_number = port_serial_number();
    for (;;) {
        flush();
        own_node_id = node.lss.node_id;
        heed_outcomes();
        if (ticked_ms != now_ms()) {
            ticked_ms = now_ms();
            has_booted = tick(has_booted);
        }
        if (queue_take(&frame) && has_booted) {
            heed(&frame);
        }
        node.lss.is_switching = 0; /* this board knows one bit rate, which it has */
        if (node.program.is_resetting) {
            flush();
            while (queue_is_sending()) { /* the answer; the watchdog ends a wait in vain */
            }
            port_reset();
        }
        port_alive();
        port_idle(queue_waits);
    }
}
