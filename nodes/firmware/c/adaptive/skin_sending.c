#include "skin_sending.h"

#include <math.h>
#include <string.h>

#define LONG_AGO (-((int64_t)1 << 30))
#define NEVER ((int64_t)1 << 60)

void skin_groups_forget(skin_groups *all, uint8_t is_fd)
{
    uint8_t group;

    memset(all, 0, sizeof *all);
    all->is_fd = is_fd;
    memset(&all->known_code[1], SKIN_OTHER_CODES + 1, sizeof all->known_code - 1); /* the codes of 0 */
    for (group = 0; group < SKIN_GROUPS; group++) {
        skin_group *each = &all->groups[group];

        each->since = -1;
        each->sent_at = LONG_AGO;
        each->refresh_at = NEVER;
        each->check = SKIN_NO_CHECK;
        each->level = SKIN_NOT_DUE;
    }
}

void skin_ask(skin_groups *all, uint8_t group, int64_t now)
{
    skin_group *each = &all->groups[group];

    if (each->is_wanted == 0) { /* who asks again does not begin the wait anew */
        each->refresh_at = now;
    }
    each->is_wanted = 1;
    each->refreshes = each->refreshes < 1 ? 1 : each->refreshes;
}

/* Tell whether a fine frame can tell all sums of a group: it refines the newest coarse codes, with CAN FD its own. */
static int is_in_reach(const skin_groups *all, uint8_t group, const float *sums_n)
{
    uint8_t place;

    if (all->groups[group].check == SKIN_NO_CHECK && !all->is_fd) {
        return 0;
    }
    for (place = (uint8_t)(SKIN_GROUP_SUMS * group); place < SKIN_GROUP_SUMS * (group + 1); place++) {
        const double now_n = sums_n[place];
        const int32_t near = all->is_fd ? skin_fine_steps(skin_coarse_value(skin_coarse_code(now_n, place), place))
                                        : all->coarse_steps[place];
        const int32_t apart = skin_fine_steps(now_n) - near;

        if (apart > SKIN_FINE_LIMIT || apart < -SKIN_FINE_LIMIT) {
            return 0;
        }
    }
    return 1;
}

/* Binary logarithm of a number above 0 by IEEE 754 operations alone: log2 of a library may round differently. */
static double log2_of(double value)
{
    static const double series[] = SKIN_LOG2_SERIES;
    int exponent, place = (int)(sizeof series / sizeof series[0]) - 1;
    double part = frexp(value, &exponent), ratio, square, total = series[place];

    if (part < SKIN_LEAST_PART) {
        part += part;
        exponent--;
    }
    ratio = (part - 1.0) / (part + 1.0);
    square = ratio * ratio;
    while (place-- > 0) {
        total = series[place] + square * total;
    }
    return exponent + ratio * total;
}

/* Level of news; the highest is for news that waited, so that no motion of others delays such news for ever. */
static int8_t urgency(double ratio, int64_t waited, const skin_rule *rule)
{
    double level;

    if (waited >= rule->patience) {
        return SKIN_LEVELS - 1;
    }
    level = (log2_of(ratio) + (double)waited / rule->doubling) / rule->level_ratio;
    return (int8_t)(level < SKIN_LEVELS - 2 ? level : SKIN_LEVELS - 2);
}

/* Tell whether a group is to be sent again. */
static int is_refresh_due(const skin_group *each, int64_t now)
{
    return each->refreshes > 0 && now >= each->refresh_at;
}

static int8_t refresh_level(const skin_group *each, int64_t now, const skin_rule *rule)
{
    const int64_t overdue = (now - each->refresh_at) / rule->overdue;

    return (int8_t)(overdue < SKIN_LEVELS - 1 ? overdue : SKIN_LEVELS - 1);
}

static void decide_group(skin_groups *all, uint8_t group, int64_t now, const float *sums_n, const float *variance_n2,
                         double noise_n2, const skin_rule *rule)
{
    skin_group *each = &all->groups[group];
    const uint8_t first = (uint8_t)(SKIN_GROUP_SUMS * group);
    const int64_t wait = now - each->sent_at;
    const double bound_n = rule->rounding * SKIN_FINE_N;
    const float quiet_n = (float)bound_n * 0.999f;
    double coarse_n2 = 0, fine_n2 = 0, variance = 0, threshold_n2;
    uint8_t place;

    each->level = SKIN_NOT_DUE;
    each->reason = SKIN_NEWS;
    each->is_fine = 0;
    for (place = first; place < first + SKIN_GROUP_SUMS; place++) {
        const double known_n = all->known_n[place];
        double error_n, square_n2;

        variance += variance_n2[place];
        if (fabsf(sums_n[place] - (float)known_n) < quiet_n - fabsf(sums_n[place]) * 1e-6f) {
            continue; /* clear by single precision */
        }
        error_n = sums_n[place] - known_n;
        if (fabs(error_n) <= bound_n) {
            continue; /* less than the least coarse step, too */
        }
        square_n2 = error_n * error_n;
        fine_n2 += square_n2;
        if (skin_is_beyond(error_n, rule->rounding, known_n, place) &&
            skin_coarse_code(sums_n[place], place) != all->known_code[place]) {
            coarse_n2 += square_n2;
        }
    }
    threshold_n2 = noise_n2 + rule->variance_ratio * variance;
    if (coarse_n2 > threshold_n2) {
        if (each->since < 0) {
            each->since = now;
        }
        if (wait >= rule->inhibit) {
            each->level = urgency(coarse_n2 / threshold_n2, now - each->since, rule);
            if (each->is_wanted != 0) { /* a group that somebody asked for needs no budget */
                const int8_t level = refresh_level(each, now, rule);

                each->level = level > each->level ? level : each->level;
                each->reason = SKIN_REFRESH;
            }
        }
        return;
    }
    each->since = -1;
    if (is_refresh_due(each, now)) {
        each->level = refresh_level(each, now, rule);
        each->reason = SKIN_REFRESH;
        /* With CAN FD a fine frame has the coarse codes, too: there is no turn to take. A fine frame knows no higher
         * level: a refresh that waits longer is coarse, out of turn, too.
         */
        each->is_fine = (each->fine_turn != 0 || all->is_fd) && each->is_wanted == 0 &&
                        each->level < SKIN_FINE_LEVELS && is_in_reach(all, group, sums_n);
    } else if (wait >= rule->fine_wait && fine_n2 > rule->fine_ratio * noise_n2 + rule->variance_ratio * variance &&
               is_in_reach(all, group, sums_n)) {
        each->level = 0;
        each->reason = SKIN_DETAIL;
        each->is_fine = 1;
    }
}

void skin_groups_decide(skin_groups *all, int64_t now, const float *sums_n, const float *variance_n2, double noise_n,
                        const skin_rule *rule)
{
    const double part_n = rule->noise_ratio * noise_n;
    uint8_t group;

    for (group = 0; group < SKIN_GROUPS; group++) {
        if (all->groups[group].under_way == 0) {
            decide_group(all, group, now, sums_n, variance_n2, SKIN_GROUP_SUMS * SKIN_BLOCK_SUMS * (part_n * part_n), rule);
        }
    }
}

uint8_t skin_groups_of_frame(const skin_groups *all)
{
    return all->is_fd ? SKIN_FD_GROUPS : 1;
}

static uint8_t frames_of_node(const skin_groups *all)
{
    return (uint8_t)(SKIN_GROUPS / skin_groups_of_frame(all));
}

uint8_t skin_tpdo_of(const skin_groups *all, uint8_t group)
{
    const skin_group *each = &all->groups[group];
    const int level = each->is_fine && each->level > SKIN_FINE_LEVELS - 1 ? SKIN_FINE_LEVELS - 1 : each->level;
    const int kind = (each->is_fine ? SKIN_KINDS : SKIN_LEVELS) - 1 - level;

    return (uint8_t)(frames_of_node(all) * kind + group / skin_groups_of_frame(all));
}

uint8_t skin_group_of(const skin_groups *all, uint8_t tpdo)
{
    return (uint8_t)(tpdo % frames_of_node(all) * skin_groups_of_frame(all));
}

uint8_t skin_is_fine(const skin_groups *all, uint8_t tpdo)
{
    return tpdo / frames_of_node(all) >= SKIN_LEVELS;
}

uint8_t skin_payload_bytes(const skin_groups *all, uint8_t is_fine)
{
    return (uint8_t)(SKIN_GROUP_SUMS * skin_groups_of_frame(all) * (all->is_fd && is_fine ? 2 : 1));
}

static void make_coarse(uint8_t group, const float *sums_n, uint8_t *payload)
{
    uint8_t place;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        const uint8_t sum = (uint8_t)(SKIN_GROUP_SUMS * group + place);

        payload[place] = skin_coarse_code(sums_n[sum], sum);
    }
}

/* Write the fine payload of a group; `coarse` holds the codes of the same CAN FD frame. With CAN FD all groups of a frame are
 * refined as soon as one has details: a sum out of reach is brought as near as the reach allows.
 */
static void make_fine(const skin_groups *all, uint8_t group, const float *sums_n, const uint8_t *coarse,
                      uint8_t *payload)
{
    int32_t steps[SKIN_GROUP_SUMS];
    uint8_t place;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        const uint8_t sum = (uint8_t)(SKIN_GROUP_SUMS * group + place);

        steps[place] = skin_fine_steps(sums_n[sum]);
        if (all->is_fd) {
            const int32_t near = skin_fine_steps(skin_coarse_value(coarse[place], sum));
            const int32_t least = near - SKIN_FINE_LIMIT, most = near + SKIN_FINE_LIMIT;

            steps[place] = steps[place] < least ? least : steps[place] > most ? most : steps[place];
        }
    }
    skin_pack_fine(steps, all->is_fd ? skin_check_of(coarse) : (uint8_t)all->groups[group].check, payload);
}

static uint8_t is_zero(uint8_t group, const float *sums_n)
{
    uint8_t place, found = 1;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        found &= sums_n[SKIN_GROUP_SUMS * group + place] == 0;
    }
    return found;
}

uint8_t skin_make_payload(skin_groups *all, uint8_t group, const float *sums_n, uint8_t *payload)
{
    const uint8_t is_fine = all->groups[group].is_fine, count = skin_groups_of_frame(all);
    const uint8_t first = (uint8_t)(group / count * count);
    uint8_t each;

    if (!all->is_fd) {
        if (is_fine) {
            make_fine(all, group, sums_n, NULL, payload);
            all->groups[group].is_zero = is_zero(group, sums_n);
        } else {
            make_coarse(group, sums_n, payload);
        }
        return SKIN_GROUP_SUMS;
    }
    for (each = 0; each < count; each++) {
        make_coarse((uint8_t)(first + each), sums_n, &payload[SKIN_GROUP_SUMS * each]);
    }
    for (each = 0; is_fine && each < count; each++) {
        make_fine(all, (uint8_t)(first + each), sums_n, &payload[SKIN_GROUP_SUMS * each],
                  &payload[SKIN_GROUP_SUMS * (count + each)]);
        all->groups[first + each].is_zero = is_zero((uint8_t)(first + each), sums_n);
    }
    return skin_payload_bytes(all, is_fine);
}

void skin_present_codes(const skin_groups *all, const float *sums_n, uint8_t *coarse, uint8_t *fine)
{
    uint8_t group;

    for (group = 0; group < SKIN_GROUPS; group++) {
        make_coarse(group, sums_n, &coarse[SKIN_GROUP_SUMS * group]);
        make_fine(all, group, sums_n, &coarse[SKIN_GROUP_SUMS * group], &fine[SKIN_GROUP_SUMS * group]);
    }
}

/* Hold the sums of a coarse payload: a finer value that the code does not contradict stays. */
static void hold_coarse(skin_groups *all, uint8_t group, const uint8_t *payload)
{
    uint8_t place;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        const uint8_t sum = (uint8_t)(SKIN_GROUP_SUMS * group + place);
        const double value_n = skin_coarse_value(payload[place], sum);

        if (all->groups[group].check == SKIN_NO_CHECK || value_n == 0 || all->known_code[sum] != payload[place]) {
            all->known_n[sum] = value_n;
            all->known_code[sum] = skin_coarse_code(value_n, sum);
        }
        all->coarse_steps[sum] = skin_fine_steps(value_n);
    }
    all->groups[group].check = skin_check_of(payload);
}

static void hold_fine(skin_groups *all, uint8_t group, const uint8_t *payload)
{
    uint8_t place;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        const uint8_t sum = (uint8_t)(SKIN_GROUP_SUMS * group + place);

        all->known_n[sum] = skin_fine_value(payload, place, all->coarse_steps[sum]);
        all->known_code[sum] = skin_coarse_code(all->known_n[sum], sum);
    }
}

static void plan_refresh(const skin_groups *all, skin_group *each, int64_t now, uint8_t is_fine, int is_at_zero,
                         const skin_rule *rule)
{
    uint8_t reason = each->reason;

    if (is_fine && each->is_wanted != 0 && !all->is_fd) {
        return; /* the coarse frame was asked for while this one was under way */
    }
    if (all->is_fd && each->refresh_after == 0) {
        reason = SKIN_NEWS; /* the first frame that carries the group */
    } else if (all->is_fd && each->level == SKIN_NOT_DUE && each->since < 0) {
        reason = SKIN_DETAIL; /* the group had no news: the frame was sent for another one */
    }
    if (reason == SKIN_NEWS || each->is_wanted != 0) {
        each->is_wanted = 0;
        each->refresh_after = rule->refresh;
        each->refreshes = rule->zero_refreshes;
        each->fine_turn = 0;
    } else if (reason == SKIN_REFRESH) {
        each->refresh_after *= 2;
        each->refresh_after = each->refresh_after < rule->refresh_max ? each->refresh_after : rule->refresh_max;
        each->refreshes--;
        each->refreshes = each->refreshes < rule->zero_refreshes ? each->refreshes : rule->zero_refreshes;
        each->fine_turn = !each->fine_turn;
    }
    if (!is_at_zero) {
        each->refreshes = NEVER;
    }
    if (reason != SKIN_DETAIL || !is_fine || all->is_fd) {
        each->refresh_at = now + each->refresh_after;
    }
}

static int is_coarse_zero(const skin_groups *all, uint8_t group)
{
    uint8_t place;

    for (place = 0; place < SKIN_GROUP_SUMS; place++) {
        if (all->coarse_steps[SKIN_GROUP_SUMS * group + place] != 0) {
            return 0;
        }
    }
    return 1;
}

void skin_note_sent(skin_groups *all, uint8_t tpdo, int64_t now, const skin_rule *rule, const uint8_t *payload)
{
    const uint8_t is_fine = skin_is_fine(all, tpdo), of_frame = skin_group_of(all, tpdo);
    const uint8_t count = skin_groups_of_frame(all);
    uint8_t part;

    if (!all->is_fd && is_fine && all->groups[of_frame].check != payload[SKIN_GROUP_SUMS - 1]) {
        return; /* it refines another coarse frame */
    }
    for (part = 0; part < count; part++) {
        const uint8_t group = (uint8_t)(of_frame + part), *coarse = &payload[SKIN_GROUP_SUMS * part];
        skin_group *each = &all->groups[group];

        if (all->is_fd || !is_fine) {
            hold_coarse(all, group, coarse);
        }
        if (is_fine) {
            hold_fine(all, group, all->is_fd ? &coarse[SKIN_GROUP_SUMS * count] : payload);
        }
        plan_refresh(all, each, now, is_fine, is_fine ? each->is_zero : is_coarse_zero(all, group), rule);
        each->sent_at = now;
        each->since = -1;
        each->level = SKIN_NOT_DUE;
    }
}
