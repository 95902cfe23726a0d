/* A node that sends sums when they carry news: TPDOs, budget and objects (docs/adaptive.md). */
#include "skin_node.h"

#if SKIN_ADAPTIVE

#include <math.h>
#include <string.h>

#define LONG_AGO (-((int64_t)1 << 40))

/* TPDOs. */

void skin_read_tpdo(skin_node *node, uint8_t number)
{
    const uint16_t communication = (uint16_t)(SKIN_OD_TPDO_COMMUNICATION + number);
    const uint32_t cob_id = skin_unsigned(node, communication, 1);

    node->tpdos[number].cob_id = (uint16_t)((cob_id & SKIN_COB_ID_INVALID) != 0 ? 0 : cob_id & 0x7FFu);
    node->tpdos[number].inhibit = (uint16_t)((skin_unsigned(node, communication, 3) + 9) / 10);
}

void skin_answer(skin_node *node, const skin_frame *sync, uint8_t counter)
{
    (void)counter;
    node->sync_ns = sync->time_ns;
}

void skin_send_events(skin_node *node, uint32_t now_ms)
{
    (void)node; /* sums are sent after each sample */
    (void)now_ms;
}

void skin_forget_sent(skin_node *node)
{
    uint8_t number;

    skin_groups_forget(&node->groups, node->board->pdo_bytes > 8);
    for (number = 0; number < node->board->tpdos; number++) {
        node->tpdos[number].made_at = LONG_AGO;
    }
    node->was_operational = 0;
}

void skin_note_state(skin_node *node)
{
    const uint8_t is_operational = node->state == SKIN_OPERATIONAL;
    uint8_t group;

    for (group = 0; is_operational && !node->was_operational && group < SKIN_GROUPS; group++) {
        skin_ask(&node->groups, group, node->now);
    }
    node->was_operational = is_operational;
}

int skin_sample(skin_node *node, uint16_t *counts)
{
    if (node->filter.taken == 0) { /* power-up: gains and offsets as they were stored */
        skin_restore(node, 0);
    }
    node->health[3] = skin_read_block(node->board, counts, node->gain, node->offset, node->pattern[0]);
    if (!skin_filter_take(&node->filter, counts)) {
        return 0;
    }
    node->now++;
    return 1;
}

void skin_decide(skin_node *node, int64_t passed_ns)
{
    const double budget = node->budget, least = (double)SKIN_SAVED_FRAMES * node->board->frame_bits[0];
    float variance_n2[SKIN_PATCH_SUMS];
    uint8_t group;

    if (budget > 0) {
        const double most = budget * SKIN_SAVING_S > least ? budget * SKIN_SAVING_S : least;
        /* Refreshes go whatever is saved. Without a limit, their debt would hold news back for minutes. */
        const double owed = node->saved > -least ? node->saved : -least;
        const double saved = owed + budget * ((double)passed_ns * 1e-9);

        node->saved = saved < most ? saved : most;
    }
    if (node->state != SKIN_OPERATIONAL) {
        return;
    }
    for (group = 0; group < SKIN_GROUPS; group++) {
        if (node->groups.groups[group].held_until < node->now) {
            node->groups.groups[group].held_until = 0;
        }
    }
    skin_filter_variance(&node->filter, variance_n2);
    skin_look(&node->groups, node->now, node->filter.sums_n, variance_n2, node->filter.noise_n, &node->rule);
}

/* Tell whether a group may send: refreshes always, news while bits are left, details while news would find some. */
static int has_budget(const skin_node *node, const skin_group *group)
{
    const uint16_t *bits = node->board->frame_bits;
    const int frames_of_all = node->groups.is_fd ? 1 : SKIN_GROUPS;
    /* Details leave so much that every group can send a coarse frame. */
    const int kept = group->reason == SKIN_DETAIL ? frames_of_all * bits[0] : 0;

    return node->budget == 0 || group->reason == SKIN_REPEATED || node->saved >= bits[group->is_fine] + kept;
}

uint16_t skin_due(const skin_node *node, uint8_t group)
{
    const skin_group *each = &node->groups.groups[group];
    const skin_tpdo *tpdo;

    if (node->state != SKIN_OPERATIONAL || each->level == SKIN_SILENT || each->held_until > 0) {
        return 0;
    }
    tpdo = &node->tpdos[skin_tpdo_of(&node->groups, group)];
    return node->now - tpdo->made_at < tpdo->inhibit || !has_budget(node, each) ? 0 : tpdo->cob_id;
}

/* Set until when a controller may hold a frame of a group, with CAN FD of all groups. */
static void hold_back(skin_node *node, uint8_t group, int64_t until)
{
    uint8_t each;

    for (each = 0; each < SKIN_GROUPS; each++) {
        if (node->groups.is_fd || each == group) {
            node->groups.groups[each].held_until = until;
        }
    }
}

void skin_send_group(skin_node *node, uint8_t group, int64_t now_ns, int64_t expires_ns)
{
    const uint8_t number = skin_tpdo_of(&node->groups, group);
    skin_frame frame = skin_new_frame(node, node->tpdos[number].cob_id, NULL, 0);

    if (!has_budget(node, &node->groups.groups[group])) {
        return;
    }
    frame.time_ns = now_ns;
    frame.expires_ns = expires_ns;
    frame.flags = node->board->frame_flags;
    frame.length = skin_make_payload(&node->groups, group, node->filter.sums_n, frame.data);
    node->tpdos[number].made_at = node->now;
    node->saved -= node->board->frame_bits[skin_is_fine(&node->groups, number)];
    hold_back(node, group, node->now + 1 + SKIN_LOST_SAMPLES);
    skin_post(node, &frame);
}

void skin_send_sums(skin_node *node, int64_t now_ns)
{
    const int64_t period_ns = (int64_t)skin_unsigned(node, SKIN_OD_CYCLE_PERIOD, 0) * 1000;
    const int64_t next_ns = node->sync_ns + period_ns;
    int64_t expires_ns = now_ns + SKIN_SAMPLE_NS;
    uint8_t turn;

    if ((node->sync_ns <= now_ns && now_ns < node->sync_ns + SKIN_PAUSE_NS) ||
        (now_ns < next_ns && next_ns < now_ns + node->board->frame_ns)) {
        return;
    }
    if (now_ns < next_ns && next_ns < expires_ns) {
        expires_ns = next_ns;
    }
    for (turn = 0; turn < SKIN_GROUPS; turn++) {
        uint16_t lowest = 0;
        uint8_t group, found = 0;

        for (group = 0; group < SKIN_GROUPS; group++) {
            const uint16_t cob_id = skin_due(node, group);

            if (cob_id != 0 && (lowest == 0 || cob_id < lowest)) {
                lowest = cob_id;
                found = group;
            }
        }
        if (lowest == 0) {
            return;
        }
        skin_send_group(node, found, now_ns, expires_ns);
    }
}

/* Number of the TPDO of a frame of ours that a controller may hold, or -1. */
static int tpdo_of(const skin_node *node, const skin_frame *frame)
{
    uint8_t number;

    for (number = 0; number < node->board->tpdos; number++) {
        if (frame->can_id != 0 && node->tpdos[number].cob_id == frame->can_id) {
            const uint8_t bytes = (uint8_t)(skin_is_fine(&node->groups, number) ? 2 * SKIN_PATCH_SUMS : SKIN_PATCH_SUMS);

            return frame->length == (node->groups.is_fd ? bytes : SKIN_GROUP_SUMS) ? number : -1;
        }
    }
    return -1;
}

void skin_sent(skin_node *node, const skin_frame *frame)
{
    const int number = tpdo_of(node, frame);

    if (number >= 0) {
        node->health[1]++;
        skin_note_sent(&node->groups, (uint8_t)number, node->now, &node->rule, frame->data);
        hold_back(node, skin_group_of(&node->groups, (uint8_t)number), 0);
    }
}

void skin_given_up(skin_node *node, const skin_frame *frame)
{
    const int number = tpdo_of(node, frame);
    uint8_t group;

    if (number < 0) {
        return;
    }
    group = skin_group_of(&node->groups, (uint8_t)number);
    if (node->groups.groups[group].held_until > 0) {
        hold_back(node, group, 0);
        node->tpdos[number].made_at = LONG_AGO;
        node->saved += node->board->frame_bits[skin_is_fine(&node->groups, (uint8_t)number)];
    }
}

void skin_refused(skin_node *node, const skin_frame *frame)
{
    skin_given_up(node, frame);
    if (tpdo_of(node, frame) >= 0) {
        node->health[2]++;
    }
}

/* Objects. */

uint32_t skin_check_adaptive(uint16_t index, uint8_t subindex, uint32_t value)
{
    const uint32_t infinite = 0x7F800000u; /* bits of REAL32; those of NaN and negative numbers are above */
    int is_right = 1;
    float real;

    if (index == SKIN_OD_REFRESH) {
        is_right = value < 1u << SKIN_GROUPS;
    } else if (index == SKIN_OD_SENDING) {
        is_right = value > 0 && ((SKIN_RULE_REALS >> subindex & 1u) == 0 || value < infinite);
    } else if (index == SKIN_OD_COEFFICIENT_NOISE || index == SKIN_OD_TAXEL_NOISE) {
        memcpy(&real, &value, sizeof real);
        is_right = real == 0 || (SKIN_LEAST_GIVEN_N <= real && real <= SKIN_MOST_GIVEN_N);
    }
    return is_right ? 0 : SKIN_ABORT_VALUE;
}

void skin_adjust_adaptive(skin_node *node, const skin_object *object, uint32_t value)
{
    const uint8_t place = (uint8_t)(object->subindex - 1);
    uint8_t group;

    switch (object->index) {
    case SKIN_OD_REFRESH:
        for (group = 0; group < SKIN_GROUPS; group++) {
            if ((value >> group & 1u) != 0) {
                skin_ask(&node->groups, group, node->now);
            }
        }
        break;
    case SKIN_OD_SENDING: /* a structure of 32-bit numbers in the same order */
        memcpy((uint8_t *)&node->rule + sizeof value * place, &value, sizeof value);
        break;
    case SKIN_OD_COEFFICIENT_NOISE:
        memcpy(&node->filter.given_coefficient_n[place], &value, sizeof value);
        skin_filter_give(&node->filter);
        break;
    case SKIN_OD_TAXEL_NOISE:
        memcpy(&node->filter.given_taxel_n[place], &value, sizeof value);
        skin_filter_give(&node->filter);
        break;
    case SKIN_OD_BUDGET:
        node->budget = value;
        node->saved = (double)SKIN_SAVED_FRAMES * node->board->frame_bits[0];
        break;
    default:
        break;
    }
}

void skin_restore_adaptive(skin_node *node)
{
    memset(node->filter.given_taxel_n, 0, sizeof node->filter.given_taxel_n);
    memset(node->filter.given_coefficient_n, 0, sizeof node->filter.given_coefficient_n);
    skin_filter_give(&node->filter);
}

static const uint8_t *put_real(uint8_t *scratch, float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof bits);
    skin_put(scratch, bits, sizeof bits);
    return scratch;
}

int32_t skin_adaptive_sum(const skin_node *node, uint8_t number)
{
    uint8_t place = 0;

    while (place < SKIN_PATCH_SUMS - 1 && skin_row_of_sum[place] != node->board->rows[number]) {
        place++;
    }
    return (int32_t)rintf(node->filter.sums_n[place] / (float)SKIN_NEWTON_PER_COUNT);
}

const uint8_t *skin_adaptive_value(const skin_node *node, const skin_object *object, uint8_t *scratch)
{
    const uint8_t place = (uint8_t)(object->subindex - 1);
    uint8_t coarse[SKIN_PATCH_SUMS], fine[SKIN_PATCH_SUMS], group;

    if (object->index == SKIN_OD_REFRESH) {
        scratch[0] = 0;
        for (group = 0; group < SKIN_GROUPS; group++) {
            scratch[0] = (uint8_t)(scratch[0] | node->groups.groups[group].is_wanted << group);
        }
        return scratch;
    }
    if (object->index == SKIN_OD_NODE_NOISE) {
        return put_real(scratch, (float)node->filter.noise_n);
    }
    if (object->subindex == 0) {
        return NULL;
    }
    switch (object->index) {
    case SKIN_OD_COEFFICIENT_NOISE:
        return put_real(scratch, node->filter.coefficient_n[place]);
    case SKIN_OD_TAXEL_NOISE:
        return put_real(scratch, node->filter.taxel_n[place]);
    case SKIN_OD_COARSE:
    case SKIN_OD_FINE:
        skin_present_codes(&node->groups, node->filter.sums_n, coarse, fine);
        if (object->index == SKIN_OD_COARSE) {
            scratch[0] = coarse[place];
        } else {
            memcpy(scratch, &fine[SKIN_GROUP_SUMS * place], SKIN_GROUP_SUMS);
        }
        return scratch;
    default:
        return NULL;
    }
}

#endif
