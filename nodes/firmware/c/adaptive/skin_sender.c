#include "skin_sender.h"

#include <math.h>
#include <string.h>

#define LONG_AGO (-((int64_t)1 << 40))

void skin_sender_forget(skin_sender *sender)
{
    uint8_t number;

    skin_groups_forget(&sender->groups, sender->board->type->pdo_bytes > 8);
    for (number = 0; number < sender->board->type->tpdos; number++) {
        sender->tpdos[number].made_at = LONG_AGO;
    }
    sender->is_operational = 0;
}

static void ask(skin_sender *sender, uint32_t groups)
{
    uint8_t group;

    for (group = 0; group < SKIN_GROUPS; group++) {
        if ((groups >> group & 1u) != 0) {
            skin_ask(&sender->groups, group, sender->now);
        }
    }
}

void skin_sender_operate(skin_sender *sender, uint8_t is_operational)
{
    if (is_operational && !sender->is_operational) {
        ask(sender, (1u << SKIN_GROUPS) - 1);
    }
    sender->is_operational = is_operational;
}

void skin_sender_configure(skin_sender *sender, uint8_t number, uint32_t cob_id, uint32_t inhibit_100us)
{
    sender->tpdos[number].cob_id = (uint16_t)((cob_id & SKIN_COB_ID_INVALID) != 0 ? 0 : cob_id & SKIN_BASE_ID_MASK);
    sender->tpdos[number].inhibit = (uint16_t)((inhibit_100us + 9) / 10);
}

int skin_sender_take(skin_sender *sender, const uint16_t *counts)
{
    sender->filter.taxels = sender->board->held;
    if (!skin_filter_take(&sender->filter, counts)) {
        return 0;
    }
    sender->now++;
    return 1;
}

/* Bits that a budget may save up at least. */
static double least_saved(const skin_sender *sender)
{
    return (double)SKIN_SAVED_FRAMES * SKIN_GROUPS * sender->board->type->frame_bits[0];
}

void skin_sender_decide(skin_sender *sender, int64_t passed_ns)
{
    const double budget = sender->budget, least = least_saved(sender);
    float variance_n2[SKIN_BLOCK_SUMS];
    uint8_t group;

    if (budget > 0) {
        const double most = budget * SKIN_SAVING_S > least ? budget * SKIN_SAVING_S : least;
        /* Refreshes go whatever is saved. Without a limit, their debt would hold news back for minutes. */
        const double owed = sender->saved > -least ? sender->saved : -least;
        const double saved = owed + budget * ((double)passed_ns * 1e-9);

        sender->saved = saved < most ? saved : most;
    }
    if (!sender->is_operational) {
        return;
    }
    for (group = 0; group < SKIN_GROUPS; group++) {
        if (sender->groups.groups[group].under_way < sender->now) {
            sender->groups.groups[group].under_way = 0;
        }
    }
    skin_filter_variance(&sender->filter, variance_n2);
    skin_groups_decide(&sender->groups, sender->now, sender->filter.sums_n, variance_n2, sender->filter.noise_n, &sender->rule);
}

int64_t skin_sender_expiry(const skin_sender *sender, int64_t now_ns, int64_t period_ns)
{
    const int64_t next_ns = sender->sync_ns + period_ns, sample_ns = now_ns + SKIN_SAMPLE_NS;

    if ((sender->sync_ns <= now_ns && now_ns < sender->sync_ns + SKIN_PAUSE_NS) ||
        (now_ns < next_ns && next_ns < now_ns + sender->board->type->frame_ns)) {
        return 0;
    }
    return now_ns < next_ns && next_ns < sample_ns ? next_ns : sample_ns;
}

/* Tell whether a group may send: refreshes always, news while bits are left, details while news would find some. */
static int has_budget(const skin_sender *sender, const skin_group *group)
{
    const uint16_t *bits = sender->board->type->frame_bits;
    const int frames_of_all = SKIN_GROUPS / skin_groups_of_frame(&sender->groups);
    /* Details leave the bits of a coarse frame for every group. */
    const int kept = group->reason == SKIN_DETAIL ? frames_of_all * bits[0] : 0;

    return sender->budget == 0 || group->reason == SKIN_REFRESH || sender->saved >= bits[group->is_fine] + kept;
}

uint16_t skin_sender_due(const skin_sender *sender, uint8_t group)
{
    const skin_group *each = &sender->groups.groups[group];
    const skin_sum_tpdo *tpdo;

    if (!sender->is_operational || each->level == SKIN_NOT_DUE || each->under_way > 0) {
        return 0;
    }
    tpdo = &sender->tpdos[skin_tpdo_of(&sender->groups, group)];
    return sender->now - tpdo->made_at < tpdo->inhibit || !has_budget(sender, each) ? 0 : tpdo->cob_id;
}

int skin_sender_most_urgent(const skin_sender *sender)
{
    uint16_t lowest = 0;
    uint8_t group;
    int found = -1;

    for (group = 0; group < SKIN_GROUPS; group++) {
        const uint16_t cob_id = skin_sender_due(sender, group);

        if (cob_id != 0 && (lowest == 0 || cob_id < lowest)) {
            lowest = cob_id;
            found = group;
        }
    }
    return found;
}

/* Set until when a controller may hold a frame of a group, and so of all groups that the frame carries. */
static void note_way(skin_sender *sender, uint8_t group, int64_t until)
{
    const uint8_t count = skin_groups_of_frame(&sender->groups), first = (uint8_t)(group / count * count);
    uint8_t each;

    for (each = first; each < first + count; each++) {
        sender->groups.groups[each].under_way = until;
    }
}

uint8_t skin_sender_make(skin_sender *sender, uint8_t group, uint8_t *payload)
{
    const uint8_t number = skin_tpdo_of(&sender->groups, group);

    if (!has_budget(sender, &sender->groups.groups[group])) {
        return 0;
    }
    sender->tpdos[number].made_at = sender->now;
    sender->saved -= sender->board->type->frame_bits[skin_is_fine(&sender->groups, number)];
    note_way(sender, group, sender->now + 1 + SKIN_LOST_SAMPLES);
    return skin_make_payload(&sender->groups, group, sender->filter.sums_n, payload);
}

/* Number of the TPDO that a frame of ours belongs to, -1 for none. */
static int tpdo_of(const skin_sender *sender, uint32_t cob_id, uint8_t length)
{
    uint8_t number;

    for (number = 0; number < sender->board->type->tpdos; number++) {
        if (cob_id != 0 && sender->tpdos[number].cob_id == cob_id) {
            return length == skin_payload_bytes(&sender->groups, skin_is_fine(&sender->groups, number)) ? number : -1;
        }
    }
    return -1;
}

int skin_sender_sent(skin_sender *sender, uint32_t cob_id, uint8_t length, const uint8_t *payload)
{
    const int number = tpdo_of(sender, cob_id, length);

    if (number >= 0) {
        skin_note_sent(&sender->groups, (uint8_t)number, sender->now, &sender->rule, payload);
        note_way(sender, skin_group_of(&sender->groups, (uint8_t)number), 0);
    }
    return number >= 0;
}

int skin_sender_give_back(skin_sender *sender, uint32_t cob_id, uint8_t length)
{
    const int number = tpdo_of(sender, cob_id, length);
    const uint8_t group = number < 0 ? 0 : skin_group_of(&sender->groups, (uint8_t)number);

    if (number >= 0 && sender->groups.groups[group].under_way > 0) {
        note_way(sender, group, 0);
        sender->tpdos[number].made_at = LONG_AGO;
        sender->saved += sender->board->type->frame_bits[skin_is_fine(&sender->groups, (uint8_t)number)];
    }
    return number >= 0;
}

int skin_sender_read(const skin_sender *sender, uint16_t index, uint8_t subindex, uint32_t *value)
{
    const skin_filter *filter = &sender->filter;
    float real;
    uint8_t group;

    if (index == SKIN_OD_REFRESH) {
        *value = 0;
        for (group = 0; group < SKIN_GROUPS; group++) {
            *value |= (uint32_t)sender->groups.groups[group].is_wanted << group;
        }
        return 1;
    }
    if (index == SKIN_OD_NODE_NOISE) {
        real = (float)filter->noise_n;
    } else if (subindex > 0 && index == SKIN_OD_COEFFICIENT_NOISE) {
        real = filter->coefficient_n[subindex - 1];
    } else if (subindex > 0 && index == SKIN_OD_TAXEL_NOISE) {
        real = filter->taxel_n[subindex - 1];
    } else {
        return 0;
    }
    memcpy(value, &real, sizeof real);
    return 1;
}

void skin_sender_write(skin_sender *sender, uint16_t index, uint8_t subindex, uint32_t value)
{
    const uint8_t place = (uint8_t)(subindex - 1);
    skin_filter *filter = &sender->filter;

    switch (index) {
    case SKIN_OD_REFRESH:
        ask(sender, value);
        break;
    case SKIN_OD_SENDING: /* a structure of 32-bit numbers in the same order */
        memcpy((uint8_t *)&sender->rule + sizeof value * place, &value, sizeof value);
        break;
    case SKIN_OD_COEFFICIENT_NOISE:
    case SKIN_OD_TAXEL_NOISE:
        memcpy(&(index == SKIN_OD_TAXEL_NOISE ? filter->given_taxel_n : filter->given_coefficient_n)[place], &value,
               sizeof value);
        skin_filter_give(filter);
        break;
    case SKIN_OD_BUDGET:
        sender->budget = value;
        sender->saved = least_saved(sender);
        break;
    default:
        break;
    }
}

int skin_sender_allows(uint16_t index, uint8_t subindex, uint32_t value)
{
    const uint32_t infinite = 0x7F800000u; /* bits of REAL32; those of NaN and negative numbers are above */
    float real;

    if (index == SKIN_OD_REFRESH) {
        return value < 1u << SKIN_GROUPS;
    }
    if (index == SKIN_OD_SENDING) {
        return value > 0 && ((SKIN_RULE_REALS >> subindex & 1u) == 0 || value < infinite);
    }
    if (index == SKIN_OD_COEFFICIENT_NOISE || index == SKIN_OD_TAXEL_NOISE) {
        memcpy(&real, &value, sizeof real);
        return real == 0 || (SKIN_LEAST_GIVEN_NOISE_N <= real && real <= SKIN_MOST_GIVEN_NOISE_N);
    }
    return 1;
}

int32_t skin_sender_sum(const skin_sender *sender, uint8_t number)
{
    const float most = (float)SKIN_BLOCK_SUMS * sender->board->type->count_max;
    uint8_t place = 0;
    float counts;

    while (place < SKIN_BLOCK_SUMS - 1 && skin_row_of_sum[place] != SKIN_ROWS(sender->board)[number]) {
        place++;
    }
    counts = rintf(sender->filter.sums_n[place] / (float)SKIN_NEWTON_PER_COUNT);
    /* A forecast may exceed what taxels can read, and a sum its type. */
    return (int32_t)skin_larger(-most, skin_smaller(most, counts));
}
