/* When a board sends which group of sums ("Decision" and the sections after it in docs/adaptive.md). Times are numbers of
 * samples, a millisecond each; TPDOs are counted from 0, the most urgent first.
 */
#ifndef SKIN_SENDING_H
#define SKIN_SENDING_H

#include "skin_codes.h"

#define SKIN_NOT_DUE (-1) /* in place of a level: nothing is to be sent */

enum { SKIN_NEWS, SKIN_DETAIL, SKIN_REFRESH };

typedef struct {
    int64_t since;         /* when news began; -1: none */
    int64_t sent_at;       /* newest frame of any kind */
    int64_t refresh_at, refresh_after, refreshes; /* when the next is due, time between two, how many are left */
    int64_t under_way;     /* a controller may hold a frame of the group until then; 0: it holds none */
    int16_t check;         /* of the newest coarse frame, or SKIN_NO_CHECK */
    int8_t level;          /* urgency of the frame that is due, or SKIN_NOT_DUE */
    uint8_t reason, is_fine;
    uint8_t fine_turn;     /* whether the next refresh is fine */
    uint8_t is_zero;       /* whether the newest fine payload was made of sums that are all 0 */
    uint8_t is_wanted;     /* somebody asked for a coarse frame that was not sent yet (2030h) */
} skin_group;

typedef struct {
    uint8_t is_fd; /* a frame carries SKIN_FD_GROUPS groups */
    double known_n[SKIN_BLOCK_SUMS];       /* what a receiver without losses holds */
    uint8_t known_code[SKIN_BLOCK_SUMS];   /* its coarse code */
    int32_t coarse_steps[SKIN_BLOCK_SUMS]; /* values of the newest coarse frames, fine steps */
    skin_group groups[SKIN_GROUPS];
} skin_groups;

/* Forget all frames. */
void skin_groups_forget(skin_groups *all, uint8_t is_fd);

/* Have a group sent in a coarse frame, whatever was sent before. */
void skin_ask(skin_groups *all, uint8_t group, int64_t now);

/* Decide what each group is to send.
 *
 * noise_n: of the board (2035h). Groups of which the controller holds a frame are left alone.
 */
void skin_groups_decide(skin_groups *all, int64_t now, const float *sums_n, const float *variance_n2, double noise_n,
                        const skin_rule *rule);

/* TPDO of the frame that a group is to be sent in, of a group that is not SKIN_NOT_DUE. */
uint8_t skin_tpdo_of(const skin_groups *all, uint8_t group);

/* How many groups a frame carries, and its bytes: 8 for each, in a fine frame of CAN FD twice as many. */
uint8_t skin_groups_of_frame(const skin_groups *all);
uint8_t skin_payload_bytes(const skin_groups *all, uint8_t is_fine);

/* First group and kind of a TPDO's frames. */
uint8_t skin_group_of(const skin_groups *all, uint8_t tpdo);
uint8_t skin_is_fine(const skin_groups *all, uint8_t tpdo);

/* Write the payload of a group's frame of the present sums; returns its bytes. */
uint8_t skin_make_payload(skin_groups *all, uint8_t group, const float *sums_n, uint8_t *payload);

/* Write the coarse codes (2110h) and the fine codes (2111h) of the present sums, a byte for each sum. */
void skin_present_codes(const skin_groups *all, const float *sums_n, uint8_t *coarse, uint8_t *fine);

/* Take note of a frame of a TPDO that was sent: hold what a receiver holds of it, and plan the next refresh. */
void skin_note_sent(skin_groups *all, uint8_t tpdo, int64_t now, const skin_rule *rule, const uint8_t *payload);

#endif
