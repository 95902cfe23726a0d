#include "skin_slots.h"

#include <string.h>

#include "skin_bytes.h"
#include "skin_sums.h"

enum { NUMBER = 0, KEY = 4, BYTES = 8, CRC = 12 }; /* places in the head */

/* Compute the CRC-32 of head and data of a slot; returns 0 on success. */
static int compute_crc(const skin_flash *flash, uint8_t slot, const uint8_t *head, uint32_t *crc)
{
    const uint32_t bytes = skin_get(&head[BYTES], 4);
    uint8_t part[SKIN_SLOT_HEAD];
    uint32_t at;

    if (bytes > flash->slot_bytes - SKIN_SLOT_HEAD) {
        return 1;
    }
    *crc = skin_crc32(0, head, CRC);
    for (at = 0; at < bytes; at += sizeof part) {
        const uint16_t count = (uint16_t)(bytes - at < sizeof part ? bytes - at : sizeof part);

        if (flash->read(flash->context, slot, SKIN_SLOT_HEAD + at, part, count) != 0) {
            return 1;
        }
        *crc = skin_crc32(*crc, part, count);
    }
    return 0;
}

int skin_slot_is_whole(const skin_flash *flash, uint8_t slot, uint8_t *head)
{
    uint32_t crc;

    return flash->read(flash->context, slot, 0, head, SKIN_SLOT_HEAD) == 0 && compute_crc(flash, slot, head, &crc) == 0 &&
           crc == skin_get(&head[CRC], 4);
}

uint8_t skin_slot_newest(const skin_flash *flash, uint8_t record, uint8_t *head)
{
    uint8_t heads[2][SKIN_SLOT_HEAD], whole[2], each;

    for (each = 0; each < 2; each++) {
        whole[each] = (uint8_t)skin_slot_is_whole(flash, (uint8_t)(2 * record + each), heads[each]);
    }
    if (!whole[0] && !whole[1]) {
        return SKIN_NO_SLOT;
    }
    each = whole[0] && whole[1] ? skin_is_due(skin_get(heads[1], 4), skin_get(heads[0], 4)) != 0 : whole[1];
    memcpy(head, heads[each], SKIN_SLOT_HEAD);
    return (uint8_t)(2 * record + each);
}

static int load(void *context, uint8_t record, uint32_t key, uint8_t *data, uint16_t bytes)
{
    const skin_flash *flash = context;
    uint8_t head[SKIN_SLOT_HEAD];
    const uint8_t slot = skin_slot_newest(flash, record, head);

    if (slot == SKIN_NO_SLOT || skin_get(&head[KEY], 4) != key || skin_get(&head[BYTES], 4) != bytes) {
        return 1;
    }
    return flash->read(flash->context, slot, SKIN_SLOT_HEAD, data, bytes);
}

static int save(void *context, uint8_t record, uint32_t key, const uint8_t *data, uint16_t bytes)
{
    const skin_flash *flash = context;
    uint8_t head[SKIN_SLOT_HEAD];
    uint8_t slot = skin_slot_newest(flash, record, head);
    const uint32_t number = slot == SKIN_NO_SLOT ? 0 : skin_get(&head[NUMBER], 4) + 1;

    slot = slot == SKIN_NO_SLOT ? (uint8_t)(2 * record) : slot ^ 1u;
    skin_put(&head[NUMBER], number, 4);
    skin_put(&head[KEY], key, 4);
    skin_put(&head[BYTES], bytes, 4);
    skin_put(&head[CRC], skin_crc32(skin_crc32(0, head, CRC), data, bytes), 4);
    /* The head last: without it the slot is not whole. */
    if (bytes > flash->slot_bytes - SKIN_SLOT_HEAD || flash->erase(flash->context, slot) != 0 ||
        (bytes > 0 && flash->write(flash->context, slot, SKIN_SLOT_HEAD, data, bytes) != 0) ||
        flash->write(flash->context, slot, 0, head, SKIN_SLOT_HEAD) != 0) {
        return 1;
    }
    return skin_slot_is_whole(flash, slot, head) ? 0 : 1;
}

int skin_slot_seal(const skin_flash *flash, uint8_t slot, uint32_t bytes)
{
    uint8_t head[SKIN_SLOT_HEAD];
    const uint32_t number = skin_slot_newest(flash, slot / 2, head) == SKIN_NO_SLOT ? 0 : skin_get(&head[NUMBER], 4) + 1;
    uint32_t crc;

    memset(head, 0, sizeof head);
    skin_put(&head[NUMBER], number, 4);
    skin_put(&head[BYTES], bytes, 4);
    if (compute_crc(flash, slot, head, &crc) != 0) {
        return 1;
    }
    skin_put(&head[CRC], crc, 4);
    return flash->write(flash->context, slot, 0, head, sizeof head) != 0 || !skin_slot_is_whole(flash, slot, head);
}

skin_storage skin_slots(const skin_flash *flash)
{
    skin_storage storage;

    storage.load = load;
    storage.save = save;
    storage.context = (void *)flash;
    return storage;
}
