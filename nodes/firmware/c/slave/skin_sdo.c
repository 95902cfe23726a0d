/* The SDO server (CiA 301, 7.2.4): expedited and segmented transfers; block transfer for programs (1F50h) alone. */
#include <string.h>

#include "skin_node.h"

/* Command specifiers, the upper three bits of the first byte. */
enum { DOWNLOAD_SEGMENT = 0, DOWNLOAD = 1, UPLOAD = 2, UPLOAD_SEGMENT = 3, ABORT = 4, BLOCK_UPLOAD = 5, BLOCK_DOWNLOAD = 6 };
#define TOGGLE 0x10u
#define EXPEDITED 0x02u
#define SIZE_SPECIFIED 0x01u
#define NO_MORE_DATA 0x01u
#define CRC_SUPPORTED 0x04u
#define BLOCK_TIMEOUT_MS 1000u

enum { IDLE, SENDING, TAKING, BLOCKS, ENDING };

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

static int is_program(const skin_node *node)
{
    return node->sdo.index == SKIN_OD_PROGRAM_DATA && node->sdo.subindex == 1;
}

/* Abort the transfer with a code other than 0; tell whether the code was 0. */
static int is_taken(skin_node *node, uint32_t code)
{
    if (code != 0) {
        abort_transfer(node, code);
    }
    return code == 0;
}

/* Answer an upload: a value of more than four bytes follows in segments. */
static void upload(skin_node *node)
{
    skin_sdo *sdo = &node->sdo;
    const skin_object *object = skin_find(node->board, sdo->index, sdo->subindex);
    uint8_t scratch[SKIN_NUMBER_BYTES], bytes;
    const uint8_t *value;

    if (object == NULL) {
        abort_transfer(node, skin_missing(node->board, sdo->index));
        return;
    }
    if (is_program(node)) {
        abort_transfer(node, SKIN_ABORT_WRITE_ONLY);
        return;
    }
    value = skin_value(node, object, scratch);
    if (value == NULL) {
        abort_transfer(node, SKIN_ABORT_NO_DATA);
        return;
    }
    bytes = object->bytes;
    if (sdo->index == SKIN_OD_SOFTWARE_VERSION) {
        value = skin_program_version(&node->program, value, &bytes);
    }
    if (bytes <= 4) {
        accept(node, (uint8_t)(0x43u | (4u - bytes) << 2), value, bytes);
        return;
    }
    if (value == scratch) { /* a number may change during the transfer, a text does not */
        memcpy(sdo->data, scratch, bytes);
        value = sdo->data;
    }
    sdo->mode = SENDING;
    sdo->toggle = 0;
    sdo->done = 0;
    sdo->bytes = bytes;
    sdo->source = value;
    skin_put(scratch, bytes, 4);
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
    return is_taken(node, skin_write(node, node->sdo.index, node->sdo.subindex, data, length));
}

static void download(skin_node *node, const uint8_t *request)
{
    const uint8_t command = request[0];
    const skin_object *object;
    uint8_t size = 4;

    if ((command & EXPEDITED) == 0) {
        if (is_program(node) && !is_taken(node, skin_program_begin(&node->program))) {
            return;
        }
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
    if (sdo->done > SKIN_LONGEST_VALUE) {
        abort_transfer(node, SKIN_ABORT_TOO_LONG);
        return;
    }
    if ((command & TOGGLE) != sdo->toggle) {
        abort_transfer(node, SKIN_ABORT_TOGGLE);
        return;
    }
    if (is_program(node) && !is_taken(node, skin_program_take(&node->program, &request[1], size))) {
        return;
    }
    for (place = 0; place < size && !is_program(node); place++) {
        if (sdo->done < sizeof sdo->data) { /* no other object that can be written is longer */
            sdo->data[sdo->done] = request[1 + place];
        }
        sdo->done++;
    }
    if ((command & NO_MORE_DATA) != 0) {
        if (is_program(node) ? !is_taken(node, skin_program_end(&node->program)) : !is_written(node, sdo->data, sdo->done)) {
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

/* Block download (CiA 301, 7.2.4.3.9 to 7.2.4.3.11), of a program alone: other objects are short. */

static void block_download(skin_node *node, const uint8_t *request, uint32_t now_ms)
{
    skin_sdo *sdo = &node->sdo;
    uint8_t block_segments[] = {SKIN_BLOCK_SEGMENTS};

    if ((request[0] & 1u) != 0 || !is_program(node)) {
        abort_transfer(node, SKIN_ABORT_COMMAND);
        return;
    }
    if (!is_taken(node, skin_program_begin(&node->program))) {
        return;
    }
    sdo->mode = BLOCKS;
    sdo->number = 0;
    sdo->done = 0;
    sdo->crc = 0;
    sdo->has_crc = request[0] & CRC_SUPPORTED;
    sdo->due_ms = now_ms + BLOCK_TIMEOUT_MS;
    accept(node, SKIN_SDO_BLOCKS_BEGUN | CRC_SUPPORTED, block_segments, sizeof block_segments);
}

/* CRC of block transfers (CiA 301, 7.2.4.3.16): polynomial 1021h, initial value 0. */
static uint16_t add_to_crc(uint16_t crc, const uint8_t *data, uint8_t bytes)
{
    uint8_t bit;

    while (bytes-- > 0) {
        crc = (uint16_t)(crc ^ *data++ << 8);
        for (bit = 0; bit < 8; bit++) {
            crc = (uint16_t)((crc & 0x8000u) != 0 ? crc << 1 ^ 0x1021 : crc << 1);
        }
    }
    return crc;
}

/* Take the first `bytes` of the segment that waits: how many of the last segment count is told by the end. */
static int is_waiting_taken(skin_node *node, uint8_t bytes)
{
    skin_sdo *sdo = &node->sdo;

    sdo->crc = add_to_crc(sdo->crc, sdo->data, bytes);
    return is_taken(node, skin_program_take(&node->program, sdo->data, bytes));
}

static void block_segment(skin_node *node, const uint8_t *request, uint32_t now_ms)
{
    skin_sdo *sdo = &node->sdo;
    const uint8_t number = request[0] & 0x7Fu, is_last = request[0] >> 7;
    uint8_t response[8] = {SKIN_SDO_BLOCK_TAKEN, 0, SKIN_BLOCK_SEGMENTS};

    if (number == sdo->number + 1) { /* requests of another client keep no transfer open */
        sdo->due_ms = now_ms + BLOCK_TIMEOUT_MS;
        if (sdo->done > 0 && !is_waiting_taken(node, (uint8_t)sdo->done)) {
            return;
        }
        sdo->done = 7;
        memcpy(sdo->data, &request[1], 7);
        sdo->number = number;
        sdo->mode = is_last ? ENDING : BLOCKS;
    }
    if (is_last || number >= SKIN_BLOCK_SEGMENTS) { /* the client sends again what came after a gap */
        response[1] = sdo->number;
        sdo->number = 0;
        respond(node, response);
    }
}

static void end_blocks(skin_node *node, const uint8_t *request)
{
    skin_sdo *sdo = &node->sdo;
    uint8_t response[8] = {SKIN_SDO_BLOCKS_TAKEN};

    if (!is_waiting_taken(node, (uint8_t)(7u - (request[0] >> 2 & 7u)))) {
        return;
    }
    if (sdo->has_crc && sdo->crc != skin_get(&request[1], 2)) {
        abort_transfer(node, SKIN_ABORT_CRC);
        return;
    }
    if (is_taken(node, skin_program_end(&node->program))) {
        sdo->mode = IDLE;
        respond(node, response);
    }
}

void skin_sdo_tick(skin_node *node, uint32_t now_ms)
{
    if ((node->sdo.mode == BLOCKS || node->sdo.mode == ENDING) && skin_is_due(now_ms, node->sdo.due_ms)) {
        abort_transfer(node, SKIN_ABORT_TIMEOUT);
    }
}

void skin_serve(skin_node *node, const skin_frame *request, uint32_t now_ms)
{
    const uint8_t *data = request->data;
    const uint8_t specifier = data[0] >> 5;

    if (node->sdo.mode == BLOCKS && data[0] != ABORT << 5) {
        block_segment(node, data, now_ms);
        return;
    }
    if (node->sdo.mode == ENDING && specifier == BLOCK_DOWNLOAD && (data[0] & 1u) != 0) {
        end_blocks(node, data);
        return;
    }
    if (specifier == DOWNLOAD || specifier == UPLOAD || specifier == BLOCK_UPLOAD || specifier == BLOCK_DOWNLOAD) {
        node->sdo.index = (uint16_t)skin_get(&data[1], 2);
        node->sdo.subindex = data[3];
        if (SKIN_OD_PROGRAM_DATA <= node->sdo.index && node->sdo.index <= SKIN_OD_FLASH_STATUS &&
            node->program.flash == NULL) {
            abort_transfer(node, SKIN_ABORT_NO_OBJECT);
            return;
        }
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
    case BLOCK_DOWNLOAD:
        node->sdo.mode = IDLE;
        block_download(node, data, now_ms);
        break;
    default:
        abort_transfer(node, SKIN_ABORT_COMMAND);
        break;
    }
}
