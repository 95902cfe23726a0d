/* The SDO server (CiA 301, 7.2.4): expedited and segmented transfers; block transfer is refused. */
#include <string.h>

#include "skin_node.h"

/* Command specifiers, the upper three bits of the first byte. */
enum { DOWNLOAD_SEGMENT = 0, DOWNLOAD = 1, UPLOAD = 2, UPLOAD_SEGMENT = 3, ABORT = 4, BLOCK_UPLOAD = 5, BLOCK_DOWNLOAD = 6 };
#define TOGGLE 0x10u
#define EXPEDITED 0x02u
#define SIZE_SPECIFIED 0x01u
#define NO_MORE_DATA 0x01u
/* More bytes than any object has. */
#define LONGEST_VALUE 256u

enum { IDLE, SENDING, TAKING };

static void respond(skin_node *node, const uint8_t *response)
{
    skin_send(node, SKIN_SDO_RESPONSE_BASE + node->board->node_id, response, 8);
}

static void abort_transfer(skin_node *node, uint32_t code)
{
    uint8_t response[8];

    node->sdo.mode = IDLE;
    response[0] = ABORT << 5;
    skin_put(&response[1], node->sdo.index, 2);
    response[3] = node->sdo.subindex;
    skin_put(&response[4], code, 4);
    respond(node, response);
}

static void accept(skin_node *node, uint8_t command, const uint8_t *data, uint8_t length)
{
    uint8_t response[8] = {0};

    response[0] = command;
    skin_put(&response[1], node->sdo.index, 2);
    response[3] = node->sdo.subindex;
    if (length > 0) {
        memcpy(&response[4], data, length);
    }
    respond(node, response);
}

/* Answer an upload: a value of more than four bytes follows in segments. */
static void upload(skin_node *node)
{
    skin_sdo *sdo = &node->sdo;
    const skin_object *object = skin_find(node->board, sdo->index, sdo->subindex);
    uint8_t scratch[SKIN_NUMBER_BYTES];
    const uint8_t *value;

    if (object == NULL) {
        abort_transfer(node, skin_missing(node->board, sdo->index));
        return;
    }
    value = skin_value(node, object, scratch);
    if (value == NULL) {
        abort_transfer(node, SKIN_ABORT_NO_DATA);
        return;
    }
    if (object->bytes <= 4) {
        accept(node, (uint8_t)(0x43u | (4u - object->bytes) << 2), value, object->bytes);
        return;
    }
    if (value == scratch) { /* a number may change during the transfer, a text does not */
        memcpy(sdo->data, scratch, object->bytes);
        value = sdo->data;
    }
    sdo->mode = SENDING;
    sdo->toggle = 0;
    sdo->done = 0;
    sdo->bytes = object->bytes;
    sdo->source = value;
    skin_put(scratch, object->bytes, 4);
    accept(node, 0x41u, scratch, 4);
}

static void upload_segment(skin_node *node, uint8_t command)
{
    skin_sdo *sdo = &node->sdo;
    uint8_t response[8] = {0};
    uint16_t left;
    uint8_t size;

    if (sdo->mode != SENDING) {
        abort_transfer(node, SKIN_ABORT_COMMAND);
        return;
    }
    if ((command & TOGGLE) != sdo->toggle) {
        abort_transfer(node, SKIN_ABORT_TOGGLE);
        return;
    }
    left = (uint16_t)(sdo->bytes - sdo->done);
    size = (uint8_t)(left < 7 ? left : 7);
    memcpy(&response[1], &sdo->source[sdo->done], size);
    sdo->done = (uint16_t)(sdo->done + size);
    response[0] = (uint8_t)(sdo->toggle | (7u - size) << 1 | (size == left ? NO_MORE_DATA : 0u));
    sdo->toggle ^= TOGGLE;
    if (size == left) {
        sdo->mode = IDLE;
    }
    respond(node, response);
}

/* Write the data of a download; tell whether the object took them. */
static int is_written(skin_node *node, const uint8_t *data, uint16_t length)
{
    const uint32_t code = skin_write(node, node->sdo.index, node->sdo.subindex, data, length);

    if (code != 0) {
        abort_transfer(node, code);
    }
    return code == 0;
}

static void download(skin_node *node, const uint8_t *request)
{
    const uint8_t command = request[0];
    const skin_object *object;
    uint8_t size = 4;

    if ((command & EXPEDITED) == 0) {
        node->sdo.mode = TAKING;
        node->sdo.toggle = 0;
        node->sdo.done = 0;
    } else {
        if ((command & SIZE_SPECIFIED) != 0) {
            size = (uint8_t)(4u - (command >> 2 & 3u));
        } else {
            object = skin_find(node->board, node->sdo.index, node->sdo.subindex);
            if (object != NULL && object->bytes < 4) {
                size = object->bytes;
            }
        }
        if (!is_written(node, &request[4], size)) {
            return;
        }
    }
    accept(node, 0x60u, NULL, 0);
}

static void download_segment(skin_node *node, const uint8_t *request)
{
    skin_sdo *sdo = &node->sdo;
    uint8_t response[8] = {0};
    const uint8_t command = request[0], size = (uint8_t)(7u - (command >> 1 & 7u));
    uint8_t place;

    if (sdo->mode != TAKING) {
        abort_transfer(node, SKIN_ABORT_COMMAND);
        return;
    }
    if (sdo->done > LONGEST_VALUE) {
        abort_transfer(node, SKIN_ABORT_TOO_LONG);
        return;
    }
    if ((command & TOGGLE) != sdo->toggle) {
        abort_transfer(node, SKIN_ABORT_TOGGLE);
        return;
    }
    for (place = 0; place < size; place++) {
        if (sdo->done < sizeof sdo->data) { /* no object that can be written is longer */
            sdo->data[sdo->done] = request[1 + place];
        }
        sdo->done++;
    }
    if ((command & NO_MORE_DATA) != 0) {
        if (!is_written(node, sdo->data, sdo->done)) {
            return;
        }
        sdo->mode = IDLE;
    }
    response[0] = (uint8_t)(0x20u | sdo->toggle);
    sdo->toggle ^= TOGGLE;
    respond(node, response);
}

/* A block upload becomes an upload in segments if the client allows that for this size. */
static void block_upload(skin_node *node, const uint8_t *request)
{
    const skin_object *object = skin_find(node->board, node->sdo.index, node->sdo.subindex);
    uint8_t scratch[SKIN_NUMBER_BYTES];

    if ((request[0] & 3u) != 0) {
        abort_transfer(node, SKIN_ABORT_COMMAND);
    } else if (object != NULL && skin_value(node, object, scratch) != NULL && object->bytes > request[5]) {
        abort_transfer(node, SKIN_ABORT_COMMAND);
    } else {
        node->sdo.mode = IDLE;
        upload(node);
    }
}

void skin_request(skin_node *node, const skin_frame *request, uint32_t now_ms)
{
    const uint8_t *data = request->data;
    const uint8_t specifier = data[0] >> 5;

    if (node->state != SKIN_PRE_OPERATIONAL && node->state != SKIN_OPERATIONAL) {
        return;
    }
    if (specifier == DOWNLOAD || specifier == UPLOAD || specifier == BLOCK_UPLOAD || specifier == BLOCK_DOWNLOAD) {
        node->sdo.index = (uint16_t)skin_get(&data[1], 2);
        node->sdo.subindex = data[3];
    }
    switch (specifier) {
    case DOWNLOAD_SEGMENT:
        download_segment(node, data);
        break;
    case DOWNLOAD:
        node->sdo.mode = IDLE;
        download(node, data);
        break;
    case UPLOAD:
        node->sdo.mode = IDLE;
        upload(node);
        break;
    case UPLOAD_SEGMENT:
        upload_segment(node, data[0]);
        break;
    case ABORT:
        node->sdo.mode = IDLE;
        break;
    case BLOCK_UPLOAD:
        block_upload(node, data);
        break;
    default:
        abort_transfer(node, SKIN_ABORT_COMMAND);
        break;
    }
    skin_refresh(node, now_ms);
}
