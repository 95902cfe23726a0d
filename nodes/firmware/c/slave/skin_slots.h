/* A storage function over flash memory: two slots for each record, written in turn. The newest whole one counts. */
#ifndef SKIN_SLOTS_H
#define SKIN_SLOTS_H

#include "skin_storage.h"

/* The first SKIN_SLOT_HEAD bytes of a slot: number of the copy, 1 above that of the older one; key; bytes of data;
 * CRC-32 of these and of the data. The data follow.
 */
#define SKIN_NO_SLOT 0xFFu

/* Flash memory. Slots 2 n and 2 n + 1 belong to record n; each has pages of its own for SKIN_SLOT_HEAD bytes and the data. Parts
 * begin at multiples of SKIN_SLOT_HEAD; a driver fills up the last word. Functions return 0 on success.
 */
typedef struct {
    int (*erase)(void *context, uint8_t slot);
    int (*write)(void *context, uint8_t slot, uint32_t at, const uint8_t *data, uint16_t bytes);
    int (*read)(void *context, uint8_t slot, uint32_t at, uint8_t *data, uint16_t bytes);
    uint32_t slot_bytes; /* of each slot */
    void *context;       /* passed to all */
} skin_flash;

/* The storage function; `flash` must outlive it. */
skin_storage skin_slots(const skin_flash *flash);

/* Of program download. `head` takes the first SKIN_SLOT_HEAD bytes of the slot. */

/* Whether a slot is whole. */
int skin_slot_is_whole(const skin_flash *flash, uint8_t slot, uint8_t *head);
/* The slot of the newest whole copy of a record, SKIN_NO_SLOT for none. */
uint8_t skin_slot_newest(const skin_flash *flash, uint8_t record, uint8_t *head);
/* Write the head of a slot, whose data of `bytes` bytes are there. Returns 0 on success: the slot is whole then. */
int skin_slot_seal(const skin_flash *flash, uint8_t slot, uint32_t bytes);

#endif
