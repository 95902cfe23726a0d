/* The object dictionary: reading, writing, and the rules of the communication profile. */
#include <string.h>

#include "skin_node.h"

/* 1010h and 1011h read: the node stores and restores on command. */
#define ON_COMMAND 1u

/* The block of an object of the manufacturer, and its index for the first block. */
static uint8_t block_of(uint16_t index)
{
    return (uint8_t)((index - SKIN_OD_MANUFACTURER) / SKIN_BLOCK_STRIDE);
}

static uint16_t of_first_block(uint16_t index)
{
    return index < SKIN_OD_MANUFACTURER ? index : (uint16_t)(index - SKIN_BLOCK_STRIDE * block_of(index));
}

const skin_object *skin_find(const skin_board *board, uint16_t index, uint8_t subindex)
{
    const uint32_t wanted = ((uint32_t)index << 8) | subindex;
    uint16_t low = 0, high = board->type->object_count;

    while (low < high) {
        const uint16_t middle = (uint16_t)((low + high) / 2);
        const skin_object *object = &board->type->objects[middle];
        const uint32_t found = ((uint32_t)object->index << 8) | object->subindex;

        if (found == wanted) {
            return object;
        }
        if (found < wanted) {
            low = (uint16_t)(middle + 1);
        } else {
            high = middle;
        }
    }
    return NULL;
}

uint32_t skin_missing(const skin_board *board, uint16_t index)
{
    /* Every object has sub-index 0. */
    return skin_find(board, index, 0) != NULL ? SKIN_ABORT_NO_SUBINDEX : SKIN_ABORT_NO_OBJECT;
}

uint8_t skin_error_register(const skin_node *node)
{
    static const uint8_t of_error[SKIN_ERRORS] = {SKIN_REGISTER_COMMUNICATION, SKIN_REGISTER_COMMUNICATION,
                                                  SKIN_REGISTER_MANUFACTURER};
    uint8_t bits = 0, error;

    for (error = 0; error < SKIN_ERRORS; error++) {
        bits = (uint8_t)(bits | (node->active[error] != 0 ? SKIN_REGISTER_GENERIC | of_error[error] : 0));
    }
    return bits;
}

/* Signature (2006h, 2009h): CRC-32 over index, sub-index and value of each object with one of these flags. */
static uint32_t signature(const skin_node *node, uint8_t flags)
{
    const skin_board *board = node->board;
    uint8_t head[3], scratch[SKIN_NUMBER_BYTES];
    uint32_t crc = 0;
    uint16_t place;

    for (place = 0; place < board->type->object_count; place++) {
        const skin_object *object = &board->type->objects[place];

        if ((object->flags & flags) != 0) {
            skin_put(head, object->index, 2);
            head[2] = object->subindex;
            crc = skin_crc32(crc, head, sizeof head);
            crc = skin_crc32(crc, skin_value(node, object, scratch), object->bytes);
        }
    }
    return crc;
}

/* Value of an object that is not stored, without those whose value does not exist. */
static uint32_t computed(const skin_node *node, const skin_object *object)
{
    const uint8_t subindex = object->subindex;

    if (of_first_block(object->index) == SKIN_OD_COUNTS) {
        return node->counts[block_of(object->index)][subindex - 1];
    }
    switch (object->index) {
    case SKIN_OD_ERROR_REGISTER:
        return skin_error_register(node);
    case SKIN_OD_ERROR_FIELD:
        return subindex == 0 ? node->history_count : node->history[subindex - 1];
    case SKIN_OD_STORE:
    case SKIN_OD_RESTORE:
        return ON_COMMAND;
    case SKIN_OD_SIGNATURE:
        return signature(node, SKIN_OBJECT_COVERED);
    case SKIN_OD_CALIBRATION_SIGNATURE:
        return signature(node, SKIN_OBJECT_COVERED | SKIN_OBJECT_CALIBRATING);
    case SKIN_OD_HEALTH:
        return node->health[subindex - 1];
    case SKIN_OD_PROGRAM_DATA:
    case SKIN_OD_PROGRAM_CONTROL:
    case SKIN_OD_PROGRAM_ID:
    case SKIN_OD_FLASH_STATUS:
        return skin_program_value(&node->program, object->index);
#if SKIN_STEPPED
    default: /* the sums */
        return (uint32_t)skin_raw(&node->board->type->packing, skin_filter_sum(&node->steps.filter, node->board, (uint8_t)(subindex - 1)));
#else
    case SKIN_OD_SYNC_COUNTER:
        return node->sync_counter;
    default: /* the sums */
        return (uint32_t)skin_raw(&node->board->type->packing,
                                  node->sums[node->board->type->first_sum[block_of(object->index)] + subindex - 1]);
#endif
    }
}

#if SKIN_STEPPED

/* What a stepped board computes, NULL for other objects. */
static const uint8_t *stepped_value(const skin_node *node, const skin_object *object, uint8_t *scratch)
{
    uint64_t value;
    uint8_t place;

    if (!skin_steps_read(&node->steps, object->index, object->subindex, &value)) {
        return NULL;
    }
    for (place = 0; place < object->bytes; place++) {
        scratch[place] = (uint8_t)(value >> 8 * place);
    }
    return scratch;
}

#endif

const uint8_t *skin_value(const skin_node *node, const skin_object *object, uint8_t *scratch)
{
#if SKIN_STEPPED
    const uint8_t *stepped = stepped_value(node, object, scratch);

    if (stepped != NULL) {
        return stepped;
    }
#endif
    if (object->index == SKIN_OD_IDENTITY && object->subindex == 4 && node->serial_number != 0) {
        skin_put(scratch, node->serial_number, object->bytes);
        return scratch;
    }
    if (object->at == SKIN_OBJECT_COMPUTED) {
        if (object->index == SKIN_OD_ERROR_FIELD && object->subindex > node->history_count) {
            return NULL;
        }
        skin_put(scratch, computed(node, object), object->bytes);
        return scratch;
    }
    return object->at < node->board->type->writable_bytes ? &node->values[object->at]
                                                          : skin_default(node->board, object->at);
}

uint32_t skin_unsigned(const skin_node *node, uint16_t index, uint8_t subindex)
{
    const skin_object *object = skin_find(node->board, index, subindex);
    uint8_t scratch[SKIN_NUMBER_BYTES];

    return object == NULL ? 0 : skin_get(skin_value(node, object, scratch), object->bytes);
}

uint8_t skin_mapped_bits(const skin_node *node, const skin_object *object)
{
    if (object == NULL || (object->flags & SKIN_OBJECT_MAPPABLE) == 0) {
        return 0;
    }
    return of_first_block(object->index) == SKIN_OD_SUMS ? node->board->type->packing.bits : (uint8_t)(8 * object->bytes);
}

const skin_object *skin_mapped(const skin_node *node, uint32_t entry)
{
    const skin_object *object = skin_find(node->board, (uint16_t)(entry >> 16), (uint8_t)(entry >> 8 & 0xFFu));
    const uint8_t bits = skin_mapped_bits(node, object);

    return bits != 0 && bits == (entry & 0xFFu) ? object : NULL;
}

/* COB-IDs that no PDO or EMCY may have (CiA 301, table 38). */
static int is_restricted(uint32_t can_id)
{
    static const uint16_t ranges[][2] = SKIN_RESTRICTED_COB_IDS;
    uint8_t place;

    for (place = 0; place < sizeof ranges / sizeof ranges[0]; place++) {
        if (ranges[place][0] <= can_id && can_id <= ranges[place][1]) {
            return 1;
        }
    }
    return 0;
}

/* Rules of a COB-ID: it must be free, and must not change while the message exists. */
static uint32_t check_cob_id(uint32_t present, uint32_t value)
{
    const uint32_t can_id = value & SKIN_EXTENDED_ID_MASK;

    if ((value & SKIN_COB_ID_INVALID) == 0 &&
        (can_id == 0 || can_id > SKIN_BASE_ID_MASK || can_id == SKIN_SYNC_COB_ID || (value & SKIN_COB_ID_EXTENDED) != 0 ||
         is_restricted(can_id))) {
        return SKIN_ABORT_VALUE;
    }
    if (((present | value) & SKIN_COB_ID_INVALID) == 0 && can_id != (present & SKIN_EXTENDED_ID_MASK)) {
        return SKIN_ABORT_STATE;
    }
    return 0;
}

static uint32_t check_communication(const skin_node *node, uint16_t index, uint8_t subindex, uint32_t value)
{
    const uint32_t present = skin_unsigned(node, index, 1);

    switch (subindex) {
    case 1:
        return check_cob_id(present, value);
    case 2: /* reserved, or on remote request, which is not offered */
        return SKIN_LAST_SYNCHRONOUS < value && value < SKIN_EVENT_MANUFACTURER ? SKIN_ABORT_VALUE : 0;
    case 3:
    case 6:
        return (present & SKIN_COB_ID_INVALID) == 0 ? SKIN_ABORT_STATE : 0;
    default:
        return 0;
    }
}

static uint32_t check_mapping(const skin_node *node, uint16_t index, uint8_t subindex, uint32_t value)
{
    const uint16_t communication = (uint16_t)(index - SKIN_OD_TPDO_MAPPING + SKIN_OD_TPDO_COMMUNICATION);
    uint32_t bits = 0;
    uint8_t place;

    if ((skin_unsigned(node, communication, 1) & SKIN_COB_ID_INVALID) == 0) {
        return SKIN_ABORT_STATE;
    }
    if (subindex > 0) {
        if (skin_unsigned(node, index, 0) > 0) {
            return SKIN_ABORT_STATE;
        }
        return value == 0 || skin_mapped(node, value) != NULL ? 0 : SKIN_ABORT_NOT_MAPPABLE;
    }
    if (skin_find(node->board, index, (uint8_t)value) == NULL) {
        return SKIN_ABORT_PDO_LENGTH;
    }
    for (place = 1; place <= value; place++) {
        const uint32_t entry = skin_unsigned(node, index, place);

        if (skin_mapped(node, entry) == NULL) {
            return SKIN_ABORT_NOT_MAPPABLE;
        }
        bits += entry & 0xFFu;
    }
    return bits > 8u * node->board->type->pdo_bytes ? SKIN_ABORT_PDO_LENGTH : 0;
}

uint8_t skin_watched_node(uint32_t entry)
{
    return (uint8_t)((entry & 0xFFFFu) > 0 && entry >> 16 <= SKIN_HIGHEST_NODE_ID ? entry >> 16 : 0);
}

static uint32_t check_watched(const skin_node *node, uint8_t subindex, uint32_t value)
{
    uint8_t place;

    for (place = 1; place <= SKIN_WATCHED; place++) {
        if (place != subindex && skin_watched_node(value) > 0 &&
            skin_watched_node(value) == skin_watched_node(skin_unsigned(node, SKIN_OD_CONSUMER_HEARTBEAT, place))) {
            return SKIN_ABORT_INCOMPATIBLE;
        }
    }
    return 0;
}

static uint32_t check_write(const skin_node *node, uint16_t index, uint8_t subindex, uint32_t value)
{
    if (SKIN_OD_TPDO_COMMUNICATION <= index && index < SKIN_OD_TPDO_MAPPING) {
        return check_communication(node, index, subindex, value);
    }
    if (SKIN_OD_TPDO_MAPPING <= index && index < SKIN_OD_TPDO_END) {
        return check_mapping(node, index, subindex, value);
    }
    switch (of_first_block(index)) {
    case SKIN_OD_ERROR_FIELD:
        return value != 0 ? SKIN_ABORT_VALUE : 0;
    case SKIN_OD_SYNC_COB_ID: /* a consumer, on the predefined identifier */
        return value != SKIN_SYNC_COB_ID ? SKIN_ABORT_VALUE : 0;
    case SKIN_OD_STORE:
        return value != SKIN_SIGNATURE_SAVE ? SKIN_ABORT_NOT_STORED : 0;
    case SKIN_OD_RESTORE:
        return value != SKIN_SIGNATURE_LOAD ? SKIN_ABORT_NOT_STORED : 0;
    case SKIN_OD_EMCY_COB_ID:
        return (value & SKIN_COB_ID_EXTENDED) != 0
                   ? SKIN_ABORT_VALUE
                   : check_cob_id(skin_unsigned(node, SKIN_OD_EMCY_COB_ID, 0), value);
    case SKIN_OD_CONSUMER_HEARTBEAT:
        return check_watched(node, subindex, value);
    case SKIN_OD_SYNC_OVERFLOW:
        if (value == 1 || value > SKIN_LAST_SYNCHRONOUS) {
            return SKIN_ABORT_VALUE;
        }
        return skin_unsigned(node, SKIN_OD_CYCLE_PERIOD_US, 0) > 0 ? SKIN_ABORT_STATE : 0;
    case SKIN_OD_ERROR_BEHAVIOUR:
        return value > 2 ? SKIN_ABORT_VALUE : 0;
    case SKIN_OD_GAIN: /* not infinite, and a number */
        return (value >> 23 & 0xFFu) == 0xFFu ? SKIN_ABORT_VALUE : 0;
    case SKIN_OD_TEST_PATTERN:
        return value > SKIN_PATTERN_FULL ? SKIN_ABORT_VALUE : 0;
    default:
#if SKIN_STEPPED
        return skin_steps_allow(index, subindex, value) ? 0 : SKIN_ABORT_VALUE;
#else
        return 0;
#endif
    }
}

/* Pass gains, offsets and test patterns on to the sums. */
static void adjust(skin_node *node, const skin_object *object)
{
    const uint8_t block = block_of(object->index);
    const uint32_t value = skin_get(&node->values[object->at], object->bytes);

    switch (of_first_block(object->index)) {
    case SKIN_OD_GAIN:
        memcpy(&node->gain[block][object->subindex - 1], &value, sizeof value); /* both have the same byte order */
        break;
    case SKIN_OD_OFFSET:
        node->offset[block][object->subindex - 1] = (int16_t)(value < 0x8000u ? (int32_t)value : (int32_t)value - 0x10000);
        break;
    case SKIN_OD_TEST_PATTERN:
        node->pattern[block] = (uint8_t)value;
        break;
    default:
#if SKIN_STEPPED
        skin_steps_write(&node->steps, object->index, object->subindex, value);
#endif
        break;
    }
}

/* What stored values belong to: this skin, this node-ID, and objects at these places. */
static uint32_t key_of(const skin_node *node)
{
    const skin_board *board = node->board;
    uint8_t head[4], scratch[SKIN_NUMBER_BYTES];
    const skin_object *object = skin_find(board, SKIN_OD_PHI_FINGERPRINT, 0);
    uint32_t key = skin_crc32(0, skin_value(node, object, scratch), object->bytes);
    uint16_t place;

    key = skin_crc32(key, &board->node_id, 1);
    for (place = 0; place < board->type->object_count; place++) {
        object = &board->type->objects[place];
        if ((object->flags & SKIN_OBJECT_WRITABLE) != 0) {
            skin_put(head, object->index, 2);
            head[2] = object->subindex;
            head[3] = object->bytes;
            key = skin_crc32(key, head, sizeof head);
        }
    }
    return key;
}

void skin_become(skin_node *node, const skin_board *board)
{
    const skin_storage *storage = node->storage;

    node->board = board;
#if SKIN_STEPPED
    node->steps.board = board;
#endif
    node->has_stored = storage != NULL && storage->load(storage->context, SKIN_RECORD_PARAMETERS, key_of(node),
                                                        node->stored, node->board->type->writable_bytes) == 0;
}

/* Store the first `bytes` values: all, or none. */
static uint32_t save(skin_node *node, uint16_t bytes)
{
    const skin_storage *storage = node->storage;

    if (storage == NULL) {
        return SKIN_ABORT_NOT_STORED;
    }
    if (storage->save(storage->context, SKIN_RECORD_PARAMETERS, key_of(node), node->values, bytes) != 0) {
        return SKIN_ABORT_HARDWARE;
    }
    memcpy(node->stored, node->values, bytes);
    node->has_stored = bytes > 0;
    return 0;
}

uint32_t skin_write(skin_node *node, uint16_t index, uint8_t subindex, const uint8_t *data, uint16_t length)
{
    const skin_object *object = skin_find(node->board, index, subindex);
    uint32_t abort;

    if (object == NULL) {
        return skin_missing(node->board, index);
    }
    if ((object->flags & SKIN_OBJECT_WRITABLE) == 0) {
        return SKIN_ABORT_READ_ONLY;
    }
    if (length != object->bytes) {
        return SKIN_ABORT_LENGTH;
    }
    abort = check_write(node, index, subindex, skin_get(data, object->bytes));
    if (abort != 0) {
        return abort;
    }
    if (index == SKIN_OD_PROGRAM_CONTROL) {
        return skin_program_control(&node->program, data[0]);
    } else if (index == SKIN_OD_ERROR_FIELD) {
        node->history_count = 0;
    } else if (index == SKIN_OD_STORE) {
        return save(node, node->board->type->writable_bytes);
    } else if (index == SKIN_OD_RESTORE) {
        return save(node, 0);
    } else {
        memcpy(&node->values[object->at], data, length);
    }
    if (index < SKIN_OD_MANUFACTURER) {
        node->changed = 1;
    } else {
        adjust(node, object);
    }
    return 0;
}

void skin_restore(skin_node *node, int communication_only)
{
    const skin_board *board = node->board;
    const uint16_t bytes = communication_only ? board->type->communication_bytes : board->type->writable_bytes;
    uint16_t place;

    for (place = 0; place < bytes; place++) {
        node->values[place] = node->has_stored ? node->stored[place] : *skin_default(board, place);
    }
    if (communication_only) {
        return;
    }
#if SKIN_STEPPED
    memset(node->steps.filter.given_taxel_n, 0, sizeof node->steps.filter.given_taxel_n);
    memset(node->steps.filter.given_coefficient_n, 0, sizeof node->steps.filter.given_coefficient_n);
    skin_filter_give(&node->steps.filter);
#elif SKIN_SAMPLES > 1
    for (place = 0; place < board->type->blocks; place++) {
        skin_forget(&node->averages[place]);
    }
#endif
    for (place = 0; place < board->type->object_count; place++) {
        const skin_object *object = &board->type->objects[place];

        if (object->index >= SKIN_OD_MANUFACTURER && (object->flags & SKIN_OBJECT_WRITABLE) != 0) {
            if (of_first_block(object->index) == SKIN_OD_TEST_PATTERN || object->index == SKIN_OD_REFRESH) {
                node->values[object->at] = 0; /* an order, never stored; no test pattern */
            }
            adjust(node, object);
        }
    }
}
