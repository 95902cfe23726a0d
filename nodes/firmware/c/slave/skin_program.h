/* Program download (CiA 302-3, objects 1F50h, 1F51h, 1F56h, 1F57h) into two slots of flash memory: a new program goes into the slot
 * that does not run, so that a board starts the old program or the new one whenever the power ends. docs/firmware.md of canskin,
 * "Program download", is the contract of the bootloader, for which skin_program_choose does the choice.
 */
#ifndef SKIN_PROGRAM_H
#define SKIN_PROGRAM_H

#include "contract.h"
#include "skin_slots.h"

typedef struct {
    const skin_flash *flash; /* of slots 0 and 1, for programs alone; NULL: the board has no program download */
    uint32_t vendor_id, product_code;
    uint8_t slot;                     /* of the program that runs, SKIN_NO_SLOT if no slot has it */
    uint8_t is_trial;                 /* the program has not been kept yet */
    uint8_t is_clear, is_ready;       /* of the other slot: it is erased; it has a program that can be started */
    uint8_t is_resetting;             /* the driver is to send what is in the outbox, and to reset the processor */
    uint8_t control;                  /* 1F51h */
    uint8_t error;                    /* of 1F57h */
    uint8_t head[SKIN_PROGRAM_HEAD];  /* of the program that runs */
    uint8_t taken_head[SKIN_PROGRAM_HEAD];
    uint8_t part[SKIN_SLOT_HEAD];     /* of the download: not written yet */
    uint32_t bytes;                   /* of the download */
} skin_program;

/* Of the bootloader: the slot to start, SKIN_NO_SLOT for none. The newest whole program counts. A program that was started once,
 * and not kept, gives way to the other one.
 */
uint8_t skin_program_choose(const skin_flash *flash);

/* Between the parts of the node. Functions that return a number return an abort code, 0 for success. */
void skin_program_open(skin_program *program, const skin_flash *flash, uint8_t slot);
uint32_t skin_program_begin(skin_program *program);
uint32_t skin_program_take(skin_program *program, const uint8_t *data, uint8_t bytes);
uint32_t skin_program_end(skin_program *program);
uint32_t skin_program_control(skin_program *program, uint8_t command);
void skin_program_keep(skin_program *program);
uint32_t skin_program_value(const skin_program *program, uint16_t index);
/* The version of the program that runs, or `text` of `bytes` bytes if no slot has the program. */
const uint8_t *skin_program_version(const skin_program *program, const uint8_t *text, uint8_t *bytes);

#endif
