#include "skin_program.h"

#include <string.h>

#include "skin_bytes.h"
#include "skin_sums.h"

/* Marks in the last bytes of a slot: the bootloader has started the program; the program has been reached over the bus, which is a
 * copy of the slot's head.
 */
enum { TRIED = 2 * SKIN_SLOT_HEAD, KEPT = SKIN_SLOT_HEAD };

static int read_mark(const skin_flash *flash, uint8_t slot, uint32_t mark, uint8_t *word)
{
    return flash->read(flash->context, slot, flash->slot_bytes - mark, word, SKIN_SLOT_HEAD);
}

static int is_kept(const skin_flash *flash, uint8_t slot)
{
    uint8_t head[SKIN_SLOT_HEAD], word[SKIN_SLOT_HEAD];

    return flash->read(flash->context, slot, 0, head, sizeof head) == 0 && read_mark(flash, slot, KEPT, word) == 0 &&
           memcmp(head, word, sizeof head) == 0;
}

/* Any bit of the mark counts: the power may have ended while it was written. */
static int is_tried(const skin_flash *flash, uint8_t slot)
{
    uint8_t word[SKIN_SLOT_HEAD], place;

    if (read_mark(flash, slot, TRIED, word) != 0) {
        return 1;
    }
    for (place = 0; place < sizeof word; place++) {
        if (word[place] != 0xFFu) {
            return 1;
        }
    }
    return 0;
}

/* Tell whether the other slot is whole. */
static int has_other(const skin_flash *flash, uint8_t slot)
{
    uint8_t head[SKIN_SLOT_HEAD];

    return skin_slot_is_whole(flash, slot ^ 1u, head);
}

uint8_t skin_program_choose(const skin_flash *flash)
{
    static const uint8_t tried[SKIN_SLOT_HEAD];
    uint8_t head[SKIN_SLOT_HEAD];
    const uint8_t slot = skin_slot_newest(flash, 0, head);

    if (slot == SKIN_NO_SLOT || is_kept(flash, slot) || !has_other(flash, slot)) {
        return slot;
    }
    if (is_tried(flash, slot)) {
        return slot ^ 1u;
    }
    return flash->write(flash->context, slot, flash->slot_bytes - TRIED, tried, sizeof tried) == 0 ? slot : slot ^ 1u;
}

void skin_program_open(skin_program *program, const skin_flash *flash, uint8_t slot)
{
    memset(program, 0, sizeof *program);
    program->flash = flash;
    program->slot = slot;
    program->control = SKIN_PROGRAM_START;
    if (slot != SKIN_NO_SLOT &&
        flash->read(flash->context, slot, SKIN_SLOT_HEAD, program->head, sizeof program->head) == 0) {
        program->is_trial = !is_kept(flash, slot) && has_other(flash, slot);
    }
}

void skin_program_keep(skin_program *program)
{
    const skin_flash *flash = program->flash;
    uint8_t head[SKIN_SLOT_HEAD];

    if (program->is_trial && flash->read(flash->context, program->slot, 0, head, sizeof head) == 0) {
        program->is_trial =
            flash->write(flash->context, program->slot, flash->slot_bytes - KEPT, head, sizeof head) != 0;
    }
}

/* The slot that takes downloads. */
static uint8_t other(const skin_program *program)
{
    return program->slot == 0 ? 1 : 0;
}

static uint32_t fail(skin_program *program, uint8_t error, uint32_t abort)
{
    program->error = error;
    program->is_ready = 0;
    return abort;
}

static uint32_t clear(skin_program *program)
{
    const skin_flash *flash = program->flash;

    program->is_clear = program->is_ready = 0;
    if (flash->erase(flash->context, other(program)) != 0) {
        return fail(program, SKIN_FLASH_WRITE_ERROR, SKIN_ABORT_HARDWARE);
    }
    program->is_clear = 1;
    program->error = SKIN_FLASH_NO_PROGRAM;
    return 0;
}

uint32_t skin_program_begin(skin_program *program)
{
    const uint32_t abort = program->is_clear ? 0 : clear(program);

    program->bytes = 0;
    return abort;
}

/* Write what waits in `part`; a driver fills up the last word. */
static uint32_t flush(skin_program *program)
{
    const skin_flash *flash = program->flash;
    const uint8_t waiting = (uint8_t)((program->bytes - 1) % sizeof program->part + 1);

    program->is_clear = 0;
    if (flash->write(flash->context, other(program), SKIN_SLOT_HEAD + program->bytes - waiting, program->part, waiting) != 0) {
        return fail(program, SKIN_FLASH_WRITE_ERROR, SKIN_ABORT_HARDWARE);
    }
    return 0;
}

static uint32_t check_head(skin_program *program)
{
    const uint8_t *head = program->taken_head;

    if (skin_get(&head[SKIN_PROGRAM_AT_MAGIC], 4) != SKIN_PROGRAM_MAGIC) {
        return fail(program, SKIN_FLASH_FORMAT_UNKNOWN, SKIN_ABORT_VALUE);
    }
    if (skin_get(&head[SKIN_PROGRAM_AT_VENDOR], 4) != program->vendor_id ||
        skin_get(&head[SKIN_PROGRAM_AT_PRODUCT], 4) != program->product_code) {
        return fail(program, SKIN_FLASH_FORMAT_UNKNOWN, SKIN_ABORT_INCOMPATIBLE);
    }
    if (skin_get(&head[SKIN_PROGRAM_AT_SIZE], 4) > program->flash->slot_bytes - 3 * SKIN_SLOT_HEAD - SKIN_PROGRAM_HEAD) {
        return fail(program, SKIN_FLASH_ADDRESS_ERROR, SKIN_ABORT_TOO_LONG);
    }
    return 0;
}

uint32_t skin_program_take(skin_program *program, const uint8_t *data, uint8_t bytes)
{
    uint32_t abort = 0;
    uint8_t place;

    for (place = 0; place < bytes && abort == 0; place++) {
        if (program->bytes < SKIN_PROGRAM_HEAD) {
            program->taken_head[program->bytes] = data[place];
        } else if (program->bytes - SKIN_PROGRAM_HEAD >= skin_get(&program->taken_head[SKIN_PROGRAM_AT_SIZE], 4)) {
            return fail(program, SKIN_FLASH_DATA_ERROR, SKIN_ABORT_TOO_LONG);
        }
        program->part[program->bytes++ % sizeof program->part] = data[place];
        if (program->bytes == SKIN_PROGRAM_HEAD) {
            abort = check_head(program);
        }
        if (abort == 0 && program->bytes % sizeof program->part == 0) {
            abort = flush(program);
        }
    }
    return abort;
}

/* Read the head back; compare its CRC-32 with that of the download as the memory has it, the place of the CRC left out. */
static int has_crc(skin_program *program)
{
    const skin_flash *flash = program->flash;
    uint8_t part[SKIN_SLOT_HEAD];
    uint32_t crc, at;

    if (flash->read(flash->context, other(program), SKIN_SLOT_HEAD, program->taken_head, SKIN_PROGRAM_HEAD) != 0) {
        return 0;
    }
    crc = skin_crc32(0, program->taken_head, SKIN_PROGRAM_AT_CRC);
    for (at = SKIN_PROGRAM_HEAD; at < program->bytes; at += sizeof part) {
        const uint16_t count = (uint16_t)(program->bytes - at < sizeof part ? program->bytes - at : sizeof part);

        if (flash->read(flash->context, other(program), SKIN_SLOT_HEAD + at, part, count) != 0) {
            return 0;
        }
        crc = skin_crc32(crc, part, count);
    }
    return crc == skin_get(&program->taken_head[SKIN_PROGRAM_AT_CRC], 4);
}

uint32_t skin_program_end(skin_program *program)
{
    uint32_t abort = program->bytes % sizeof program->part == 0 ? 0 : flush(program);

    if (abort != 0) {
        return abort;
    }
    if (program->bytes < SKIN_PROGRAM_HEAD ||
        program->bytes - SKIN_PROGRAM_HEAD != skin_get(&program->taken_head[SKIN_PROGRAM_AT_SIZE], 4) ||
        !has_crc(program)) {
        return fail(program, SKIN_FLASH_DATA_ERROR, SKIN_ABORT_NOT_STORED);
    }
    program->error = SKIN_FLASH_NO_ERROR;
    program->is_ready = 1;
    return 0;
}

/* Have the bootloader start the other slot. */
static uint32_t activate(skin_program *program)
{
    if (skin_slot_seal(program->flash, other(program), program->bytes) != 0) {
        return fail(program, SKIN_FLASH_WRITE_ERROR, SKIN_ABORT_HARDWARE);
    }
    program->is_ready = 0; /* a slot is sealed once */
    program->is_resetting = 1;
    return 0;
}

uint32_t skin_program_control(skin_program *program, uint8_t command)
{
    uint32_t abort = 0;

    switch (command) {
    case SKIN_PROGRAM_STOP:
        break;
    case SKIN_PROGRAM_START:
        if (program->is_ready) {
            abort = activate(program);
        } else if (program->error > SKIN_FLASH_NO_PROGRAM) { /* a download has failed */
            return SKIN_ABORT_STATE;
        }
        break;
    case SKIN_PROGRAM_RESET:
        program->is_resetting = 1;
        break;
    case SKIN_PROGRAM_CLEAR:
        abort = clear(program);
        break;
    default:
        return SKIN_ABORT_VALUE;
    }
    program->control = abort == 0 ? command : program->control;
    return abort;
}

uint32_t skin_program_value(const skin_program *program, uint16_t index)
{
    switch (index) {
    case SKIN_OD_PROGRAM_CONTROL:
        return program->control;
    case SKIN_OD_PROGRAM_ID:
        return skin_get(&program->head[SKIN_PROGRAM_AT_CRC], 4);
    default:
        return (uint32_t)program->error << 1;
    }
}

const uint8_t *skin_program_version(const skin_program *program, const uint8_t *text, uint8_t *bytes)
{
    const uint8_t *version = &program->head[SKIN_PROGRAM_AT_VERSION];

    if (version[0] == 0) {
        return text;
    }
    for (*bytes = 0; *bytes < SKIN_VERSION_BYTES && version[*bytes] != 0;) {
        (*bytes)++;
    }
    return version;
}
