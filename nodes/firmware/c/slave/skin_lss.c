/* LSS slave (CiA 305): the board gets its node-ID and its bit rate over the bus. Twin of nodes/lss.py. */
#include "skin_node.h"

/* Of the record that storage keeps: node-ID and index of the bit timing. */
enum { RECORD_BYTES = 2 };

static uint32_t address(const skin_node *node, uint8_t place)
{
    return skin_unsigned(node, SKIN_OD_IDENTITY, (uint8_t)(place + 1));
}

/* The board of this image with a node-ID on the bus of this one, NULL if it is none or of another type. */
const skin_board *skin_lss_image(const skin_node *node, uint8_t node_id)
{
    const skin_board *board = skin_board_of(node->board->bus, node_id);

    return board != NULL && board->type == node->board->type ? board : NULL;
}

void skin_lss_load(skin_node *node)
{
    uint8_t record[RECORD_BYTES];
    const skin_storage *storage = node->storage;
    skin_lss *lss = &node->lss;

    record[0] = lss->lasting;
    record[1] = SKIN_NO_BIT_TIMING;
    if (storage != NULL) {
        (void)storage->load(storage->context, SKIN_RECORD_LSS, 0, record, RECORD_BYTES);
    }
    lss->wanted = record[0];
    lss->bit_timing = record[1];
    lss->is_configured = lss->matched = lss->in_range = lss->scanned = 0;
}

/* Switch to configuration when the four numbers of the address have come in their order. */
static uint8_t select_board(skin_node *node, uint8_t place, uint32_t number)
{
    skin_lss *lss = &node->lss;

    if (lss->is_configured) {
        return 0;
    }
    lss->matched = (place == 0 || place == lss->matched) && number == address(node, place) ? (uint8_t)(place + 1) : 0;
    lss->is_configured = lss->matched == 4;
    return lss->is_configured ? SKIN_LSS_SELECTED : 0;
}

/* Vendor-ID, product code, revision from and to, serial number from and to. */
static uint8_t identify(skin_node *node, uint8_t place, uint32_t number)
{
    static const uint8_t parts[] = {0, 1, 2, 2, 3, 3};
    const uint32_t own = address(node, parts[place]);
    const int fits = place < 2 ? number == own : place % 2 == 0 ? number <= own : number >= own;
    skin_lss *lss = &node->lss;

    lss->in_range = fits && (place == 0 || place == lss->in_range) ? (uint8_t)(place + 1) : 0;
    return lss->in_range == sizeof parts ? SKIN_LSS_IDENTIFIED : 0;
}

static uint8_t fastscan(skin_node *node, uint32_t number, const uint8_t *data)
{
    const uint8_t bit = data[5], place = data[6], following = data[7];
    skin_lss *lss = &node->lss;

    if (lss->is_configured || lss->wanted != SKIN_NO_NODE_ID) {
        return 0;
    }
    if (bit == SKIN_FASTSCAN_ALL) {
        lss->scanned = 0;
    } else if (bit > 31 || place > 3 || following > 3 || place != lss->scanned || (address(node, place) ^ number) >> bit) {
        return 0;
    } else if (bit == 0) {
        lss->scanned = following;
        lss->is_configured = following < place;
    }
    return SKIN_LSS_IDENTIFIED;
}

static uint8_t save(skin_node *node)
{
    const uint8_t record[RECORD_BYTES] = {node->lss.wanted, node->lss.bit_timing};
    const skin_storage *storage = node->storage;

    if (storage == NULL) {
        return SKIN_LSS_ERROR_NOT_SUPPORTED;
    }
    if (storage->save(storage->context, SKIN_RECORD_LSS, 0, record, RECORD_BYTES) != 0) {
        return SKIN_LSS_ERROR_STORAGE;
    }
    node->lss.lasting = record[0];
    return SKIN_LSS_ERROR_NONE;
}

/* Answer a request to boards in the state LSS configuration: command, and the value or the error code behind it. */
static uint8_t configure(skin_node *node, const uint8_t *data, uint8_t *value)
{
    skin_lss *lss = &node->lss;
    const uint8_t command = data[0];

    switch (command) {
    case SKIN_LSS_NODE_ID:
        *value = data[1] == SKIN_NO_NODE_ID || skin_lss_image(node, data[1]) != NULL ? SKIN_LSS_ERROR_NONE
                                                                                     : SKIN_LSS_ERROR_NOT_SUPPORTED;
        lss->wanted = *value == SKIN_LSS_ERROR_NONE ? data[1] : lss->wanted;
        return command;
    case SKIN_LSS_BIT_TIMING:
        *value = data[1] == 0 && data[2] < 16 && (lss->bit_timings >> data[2] & 1) != 0 ? SKIN_LSS_ERROR_NONE
                                                                                        : SKIN_LSS_ERROR_NOT_SUPPORTED;
        lss->bit_timing = *value == SKIN_LSS_ERROR_NONE ? data[2] : lss->bit_timing;
        return command;
    case SKIN_LSS_ACTIVATE_BIT_TIMING:
        lss->switch_delay_ms = (uint16_t)skin_get(&data[1], 2);
        lss->is_switching = 1;
        return 0;
    case SKIN_LSS_STORE:
        *value = save(node);
        return command;
    case SKIN_LSS_INQUIRE_NODE_ID:
        *value = lss->node_id;
        return command;
    default:
        if (SKIN_LSS_INQUIRE_ADDRESS <= command && command < SKIN_LSS_INQUIRE_ADDRESS + 4) {
            skin_put(value, address(node, (uint8_t)(command - SKIN_LSS_INQUIRE_ADDRESS)), 4);
            return command;
        }
        return 0;
    }
}

int skin_lss_answer(skin_node *node, const skin_frame *request)
{
    const uint8_t *data = request->data, command = data[0];
    const uint32_t number = skin_get(&data[1], 4);
    skin_lss *lss = &node->lss;
    uint8_t answer[SKIN_LSS_BYTES] = {0};

    if (request->length != SKIN_LSS_BYTES) {
        return 0;
    }
    if (command == SKIN_LSS_SWITCH_GLOBAL) {
        lss->is_configured = data[1] <= 1 ? data[1] : lss->is_configured;
    } else if (SKIN_LSS_SWITCH_SELECTIVE <= command && command < SKIN_LSS_SWITCH_SELECTIVE + 4) {
        answer[0] = select_board(node, (uint8_t)(command - SKIN_LSS_SWITCH_SELECTIVE), number);
    } else if (SKIN_LSS_IDENTIFY <= command && command < SKIN_LSS_IDENTIFY + 6) {
        answer[0] = identify(node, (uint8_t)(command - SKIN_LSS_IDENTIFY), number);
    } else if (command == SKIN_LSS_IDENTIFY_UNNUMBERED) {
        answer[0] = lss->wanted == SKIN_NO_NODE_ID ? SKIN_LSS_IDENTIFIED_UNNUMBERED : 0;
    } else if (command == SKIN_LSS_FASTSCAN) {
        answer[0] = fastscan(node, number, data);
    } else if (lss->is_configured) {
        answer[0] = configure(node, data, &answer[1]);
    }
    if (answer[0] != 0) {
        skin_send(node, SKIN_LSS_RESPONSE_COB_ID, answer, SKIN_LSS_BYTES);
    }
    return lss->node_id == SKIN_NO_NODE_ID && lss->wanted != SKIN_NO_NODE_ID && !lss->is_configured;
}
