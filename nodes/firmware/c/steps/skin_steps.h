/* One board that sends steps, from its samples to the words of its frames ("Words" and "Slots" in docs/steps.md). Left to a
 * CANopen stack: identifiers, transmission, objects.
 */
#ifndef SKIN_STEPS_H
#define SKIN_STEPS_H

#include "skin_filter.h"

/* A TPDO and what it has sent. */
typedef struct {
    int64_t held_until_ns; /* until when the controller may hold a frame, 0 for none */
    uint16_t cob_id;       /* 0: the PDO does not exist */
    int16_t slot;          /* of the newest frame, -1 before the first */
    uint16_t sent, keep;   /* frames sent, modulo SKIN_COUNT; slots without a frame after which a check is sent */
    uint8_t unchecked;     /* frames since the newest check, up to SKIN_CHECK_EVERY */
    uint8_t unset;         /* the next group that is set whatever it is worth, or the number of groups */
} skin_way;

typedef struct {
    const skin_board *board;
    skin_filter filter;
    float quiet;         /* 2031h */
    uint8_t slots;
    uint32_t offset_us;
    uint8_t counter;     /* of the newest SYNC, 0 before the first */
    int64_t sync_ns;     /* and its end */
    int64_t done_ns;     /* the slots up to then had their turn */
    uint8_t is_operational;
    int32_t known[SKIN_BLOCK_SUMS]; /* what a receiver without losses holds, units */
    uint64_t word[SKIN_PARTS];      /* 2110h */
    skin_way ways[SKIN_TPDOS];
} skin_steps;

/* Forget all frames and identifiers, as a reset does; the noise that was learned stays. */
void skin_steps_forget(skin_steps *steps);

/* Let the board send; it begins with all its sums. Or end that. */
void skin_steps_operate(skin_steps *steps, uint8_t is_operational);

/* Begin the slots of a SYNC that ended at a time; one without counter (0) has no slots. */
void skin_steps_sync(skin_steps *steps, uint8_t counter, int64_t time_ns);

/* Take a sample, corrected counts of all taxels or those of a test pattern (2021h); returns 0 while the board learns its
 * noise.
 */
int skin_steps_take(skin_steps *steps, const uint16_t *counts, uint8_t pattern);

/* Decide what to send with the newest sample, if a slot has begun since the last call; returns the TPDOs, the first in bit 0.
 * The controller holds their frames until skin_steps_done, or for SKIN_LOST_NS.
 */
uint8_t skin_steps_choose(skin_steps *steps, int64_t now_ns);

/* Write the payload of a TPDO that was chosen; returns its bytes. */
uint8_t skin_steps_payload(const skin_steps *steps, uint8_t number, uint8_t *payload);

/* Take note that a frame was sent, or was not: then all its sums are set. */
void skin_steps_done(skin_steps *steps, uint8_t number, int was_sent);

/* Objects; `value` has the bits of a REAL32. Tell whether one of 2030h to 2033h may have a value; obey such a write; read
 * 2022h, 2030h, 2032h, 2033h, 2035h or 2110h, and return 0 for all others and for sub-index 0 of arrays.
 */
int skin_steps_allow(uint16_t index, uint8_t subindex, uint32_t value);
void skin_steps_write(skin_steps *steps, uint16_t index, uint8_t subindex, uint32_t value);
int skin_steps_read(const skin_steps *steps, uint16_t index, uint8_t subindex, uint64_t *value);

#endif
