/* Rings of frames: the interrupt writes the end of one and reads the start of the others, the main loop the other way round. */
#include <string.h>

#include "port.h"

volatile port_counts port_count;

static skin_frame received[PORT_RECEIVED], waiting[PORT_SENT], under_way;
static struct {
    uint32_t can_id;
    uint8_t flags;
} done[PORT_SENT];
/* Counters of frames; a place is a counter modulo the length of the ring. */
static volatile uint32_t received_first, received_end, waiting_first, waiting_end, done_first, done_end;
static volatile uint8_t is_under_way;

/* The compiler moves no access to memory across. */
static void barrier(void)
{
    __asm__ volatile("" : : : "memory");
}

int queue_put(const skin_frame *frame)
{
    if (received_end - received_first == PORT_RECEIVED) {
        port_count.lost++;
        return 0;
    }
    received[received_end % PORT_RECEIVED] = *frame;
    barrier();
    received_end++;
    port_count.received++;
    return 1;
}

int queue_waits(void)
{
    return received_end != received_first || done_end != done_first;
}

int queue_take(skin_frame *frame)
{
    if (received_end == received_first) {
        return 0;
    }
    barrier();
    *frame = received[received_first % PORT_RECEIVED];
    barrier();
    received_first++;
    return 1;
}

/* Interrupts are off below, up to queue_send. */

static void finish(const skin_frame *frame, int was_sent)
{
    if (was_sent) {
        port_count.sent++;
    } else {
        port_count.given_up++;
    }
    if (done_end - done_first < PORT_SENT) {
        done[done_end % PORT_SENT].can_id = frame->can_id;
        done[done_end % PORT_SENT].flags = was_sent ? SKIN_FRAME_ECHO : SKIN_FRAME_DISCARDED;
        barrier();
        done_end++;
    }
}

static int is_late(const skin_frame *frame, int64_t now_ns)
{
    return frame->expires_ns != 0 && now_ns > frame->expires_ns;
}

static void transmit_next(void)
{
    while (!is_under_way && waiting_first != waiting_end) {
        under_way = waiting[waiting_first++ % PORT_SENT];
        if (is_late(&under_way, port_now_ns())) {
            finish(&under_way, 0);
        } else {
            is_under_way = 1;
            can_transmit(&under_way);
        }
    }
}

void port_transmitted(int was_sent)
{
    if (is_under_way) {
        is_under_way = 0;
        finish(&under_way, was_sent);
    }
    transmit_next();
}

int queue_send(const skin_frame *frame)
{
    const uint32_t before = port_lock();
    const int has_room = waiting_end - waiting_first < PORT_SENT;

    if (has_room) {
        waiting[waiting_end % PORT_SENT] = *frame;
        waiting_end++;
        transmit_next();
    }
    port_unlock(before);
    return has_room;
}

void queue_tick(int64_t now_ns)
{
    const uint32_t before = port_lock();

    if (is_under_way && is_late(&under_way, now_ns)) {
        can_abort();
    }
    port_unlock(before);
}

int queue_is_sending(void)
{
    return is_under_way || waiting_first != waiting_end;
}

int queue_outcome(skin_frame *frame)
{
    if (done_end == done_first) {
        return 0;
    }
    barrier();
    memset(frame, 0, sizeof *frame);
    frame->can_id = done[done_first % PORT_SENT].can_id;
    frame->flags = done[done_first % PORT_SENT].flags;
    barrier();
    done_first++;
    return 1;
}
