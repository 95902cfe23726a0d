/* Emergencies (CiA 301, 7.2.7): one message when an error occurs and one when it is gone. */
#include "skin_node.h"

#include <string.h>

static const uint16_t error_codes[SKIN_ERRORS] = {SKIN_EMERGENCY_HEARTBEAT_LOST, SKIN_EMERGENCY_SYNC_LENGTH,
                                                  SKIN_EMERGENCY_WINDOW_MISSED};
static void drop_oldest(skin_node *node)
{
    node->waiting_count--;
    memmove(node->waiting[0], node->waiting[1], sizeof node->waiting - sizeof node->waiting[0]);
}

static void announce(skin_node *node, uint16_t code, uint64_t field)
{
    uint8_t *message;

    if (node->waiting_count == SKIN_ERRORS_KEPT) { /* the oldest is lost */
        drop_oldest(node);
    }
    message = node->waiting[node->waiting_count++];
    skin_put(message, code, 2);
    message[2] = skin_error_register(node);
    skin_put(&message[3], (uint32_t)(field & 0xFFFFFFFFu), 4);
    message[7] = (uint8_t)(field >> 32);
}

void skin_raise(skin_node *node, uint8_t error, uint64_t field)
{
    if (node->active[error] != 0) {
        return;
    }
    node->active[error] = 1;
    memmove(&node->history[1], &node->history[0], sizeof node->history - sizeof node->history[0]);
    node->history[0] = (uint32_t)(field & 0xFFFFu) << 16 | error_codes[error];
    if (node->history_count < SKIN_ERRORS_KEPT) {
        node->history_count++;
    }
    announce(node, error_codes[error], field);
}

void skin_settle(skin_node *node, uint8_t error)
{
    if (node->active[error] != 0) {
        node->active[error] = 0;
        announce(node, 0, error_codes[error]);
    }
}

void skin_flush_emergencies(skin_node *node, uint32_t now_ms)
{
    const uint32_t cob_id = skin_unsigned(node, SKIN_OD_EMCY_COB_ID, 0);
    const uint32_t inhibit_ms = (skin_unsigned(node, SKIN_OD_EMCY_INHIBIT_100US, 0) + 9) / 10;

    while (node->waiting_count > 0 && skin_is_due(now_ms, node->emcy_free_ms)) {
        if ((cob_id & SKIN_COB_ID_INVALID) == 0) {
            skin_send(node, cob_id & SKIN_BASE_ID_MASK, node->waiting[0], 8);
        }
        drop_oldest(node);
        node->emcy_free_ms = now_ms + inhibit_ms;
    }
}

int skin_take_sync(skin_node *node, const skin_frame *sync)
{
    const uint8_t counter = sync->length == 1 ? sync->data[0] : 0;
    const uint8_t expected = skin_unsigned(node, SKIN_OD_SYNC_OVERFLOW, 0) > 0 ? 1 : 0;

    if (sync->length == 1 && (counter == 0 || counter > SKIN_LAST_SYNCHRONOUS)) {
        return -1;
    }
    if (node->state == SKIN_OPERATIONAL) {
        node->health[0]++;
        if (node->health[0] - node->missed_at >= SKIN_WINDOWS_MET) {
            skin_settle(node, SKIN_ERROR_WINDOW);
        }
        if (sync->length == expected) {
            skin_settle(node, SKIN_ERROR_SYNC_LENGTH);
        } else {
            skin_raise(node, SKIN_ERROR_SYNC_LENGTH, sync->length);
        }
    }
    return counter;
}
