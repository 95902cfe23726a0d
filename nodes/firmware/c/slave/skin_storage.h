/* Memory of a board that outlives its power: flash memory, an EEPROM, or a file. The board's driver has the functions;
 * skin_slots.h makes them of two pages of flash memory.
 */
#ifndef SKIN_STORAGE_H
#define SKIN_STORAGE_H

#include <stdint.h>

#include "contract.h"

typedef struct {
    /* `record` is SKIN_RECORD_PARAMETERS, the values that 1010h stores, or SKIN_RECORD_LSS, the node-ID with the bit rate.
     * Read the newest whole record of `bytes` bytes that was saved with this key. Returns 0 on success, else 1 without a
     * change of `data`.
     */
    int (*load)(void *context, uint8_t record, uint32_t key, uint8_t *data, uint16_t bytes);
    /* Keep a record in place of an older one; with 0 bytes none is kept. Returns 0 on success. Until the new record is
     * whole, `load` finds the old one: the power may end at any time.
     */
    int (*save)(void *context, uint8_t record, uint32_t key, const uint8_t *data, uint16_t bytes);
    void *context; /* passed to both */
} skin_storage;

#endif
