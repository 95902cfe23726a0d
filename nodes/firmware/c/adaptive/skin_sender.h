/* One adaptive board, from its samples to the payloads of its frames and back: filter, decisions, inhibit times, budget. Left
 * to a CANopen stack: identifiers, transmission, objects.
 */
#ifndef SKIN_SENDER_H
#define SKIN_SENDER_H

#include "board.h"
#include "skin_filter.h"
#include "skin_sending.h"

typedef struct {
    uint16_t cob_id;  /* 0: the PDO does not exist */
    uint16_t inhibit; /* samples */
    int64_t made_at;  /* sample of the newest frame */
} skin_sum_tpdo;

typedef struct {
    const skin_board *board;
    skin_filter filter;
    skin_groups groups;
    skin_rule rule;      /* 2031h */
    int64_t now;         /* number of the newest sample */
    int64_t sync_ns;     /* end of the newest SYNC */
    uint32_t budget;     /* 2034h, bits a second */
    double saved;        /* bits */
    uint8_t is_operational;
    skin_sum_tpdo tpdos[SKIN_TPDOS];
} skin_sender;

/* Forget all frames, as a reset does; the noise that was learned stays. */
void skin_sender_forget(skin_sender *sender);

/* Let the board send; it begins with all its groups. Or end that. */
void skin_sender_operate(skin_sender *sender, uint8_t is_operational);

/* Read identifier and inhibit time of a TPDO, as 18xxh:1 and :3 have them. */
void skin_sender_configure(skin_sender *sender, uint8_t number, uint32_t cob_id, uint32_t inhibit_100us);

/* Take a sample, corrected counts of all taxels; returns 0 while the board learns its noise. */
int skin_sender_take(skin_sender *sender, const uint16_t *counts);

/* Decide what to send with the newest sample, `passed_ns` after the last decision. */
void skin_sender_decide(skin_sender *sender, int64_t passed_ns);

/* Time at which frames of now expire: the next sample, or the next SYNC; 0: none may be sent around a SYNC. */
int64_t skin_sender_expiry(const skin_sender *sender, int64_t now_ns, int64_t period_ns);

/* Identifier of the frame that a group would be sent in now, 0 for none. */
uint16_t skin_sender_due(const skin_sender *sender, uint8_t group);

/* The group whose frame is the most urgent, -1 for none. */
int skin_sender_most_urgent(const skin_sender *sender);

/* Make the frame of a group that is due: write its payload, return its bytes, 0 if the budget has gone. The frame is under
 * way until it was sent or given up, or for SKIN_LOST_SAMPLES.
 */
uint8_t skin_sender_make(skin_sender *sender, uint8_t group, uint8_t *payload);

/* Take note of a frame that was sent, with the bytes that were sent, or that was not; tell whether it is a frame of sums. */
int skin_sender_sent(skin_sender *sender, uint32_t cob_id, uint8_t length, const uint8_t *payload);
int skin_sender_give_back(skin_sender *sender, uint32_t cob_id, uint8_t length);

/* Objects; `value` has the bits of a REAL32. Tell whether one of 2030h to 2034h may have a value; obey such a write; read
 * 2030h, 2032h, 2033h or 2035h, and return 0 for all others and for sub-index 0 of arrays.
 */
int skin_sender_allows(uint16_t index, uint8_t subindex, uint32_t value);
void skin_sender_write(skin_sender *sender, uint16_t index, uint8_t subindex, uint32_t value);
int skin_sender_read(const skin_sender *sender, uint16_t index, uint8_t subindex, uint32_t *value);

/* A sum of the filtered forces, ADC counts, in the order of 2003h. */
int32_t skin_sender_sum(const skin_sender *sender, uint8_t number);

#endif
