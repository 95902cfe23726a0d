#include "skin_steps.h"

#include <math.h>
#include <string.h>

static const uint16_t scales[] = SKIN_SCALES;
#define SCALES ((uint8_t)(sizeof scales / sizeof scales[0]))
#define NO_STEP SCALES /* in place of a scale: a set takes more from the difference */

static uint8_t groups_of(const skin_type *type)
{
    return (uint8_t)((type->part_sums + SKIN_SET_SUMS - 1) / SKIN_SET_SUMS);
}

static uint8_t end_of(const skin_type *type, uint8_t group)
{
    return group + 1 < groups_of(type) ? (uint8_t)(SKIN_SET_SUMS * (group + 1)) : type->part_sums;
}

/* Least value of a sum; the first sum of a board is never negative. */
static int32_t least_of(uint8_t sum)
{
    return sum == 0 ? 0 : SKIN_OTHER_MIN;
}

/* Word of a set with its data, or with the number of groups that of a check. */
static uint64_t other_word(const skin_type *type, uint8_t group, uint64_t data, const skin_way *way)
{
    const uint64_t high = (uint64_t)(way->slot / SKIN_SYNC_OVERFLOW), kinds = groups_of(type) + 1u;

    return type->steps + group + kinds * (high + SKIN_HIGH * (way->sent + SKIN_COUNT * data));
}

static uint64_t check_word(const skin_type *type, const int32_t *known, const skin_way *way)
{
    uint32_t hash = SKIN_FNV_BASIS;
    uint8_t place;

    for (place = 0; place < type->part_sums; place++) {
        hash = (hash ^ ((uint32_t)known[place] & 0xFFu)) * SKIN_FNV_PRIME;
        hash = (hash ^ ((uint32_t)known[place] >> 8 & 0xFFu)) * SKIN_FNV_PRIME;
    }
    return other_word(type, groups_of(type), hash, way);
}

/* Set a group of the part whose first sum is `first`. */
static uint64_t set(const skin_type *type, uint8_t first, const int32_t *wanted, int32_t *known, uint8_t group,
                    const skin_way *way)
{
    uint64_t data = 0;
    uint8_t place;

    for (place = end_of(type, group); place-- > SKIN_SET_SUMS * group;) {
        known[place] = wanted[place];
        data = data << SKIN_SET_BITS | (uint32_t)(known[place] - least_of((uint8_t)(first + place)));
    }
    return other_word(type, group, data, way);
}

static int32_t digit_of(const skin_type *type, int32_t difference, int32_t scale)
{
    const int32_t nearest = (2 * (difference < 0 ? -difference : difference) + scale) / (2 * scale);
    const int32_t size = nearest < type->radix / 2 ? nearest : type->radix / 2;

    return difference < 0 ? -size : size;
}

static uint64_t step(const skin_type *type, const int32_t *wanted, int32_t *known, uint8_t scale, const skin_way *way)
{
    uint64_t word = scale + (uint64_t)SCALES * (way->sent % SKIN_SEQUENCE);
    uint8_t place;

    for (place = type->part_sums; place-- > 0;) {
        const int32_t digit = digit_of(type, wanted[place] - known[place], scales[scale]);

        word = word * type->radix + (uint32_t)(digit + type->radix / 2);
        known[place] += digit * scales[scale];
    }
    return word;
}

/* Find the scale of the best step, or NO_STEP, and the group of the best set; returns what they take from the squares. */
static int64_t best(const skin_type *type, const int32_t *wanted, const int32_t *known, int may_step, uint8_t *scale,
                    uint8_t *group)
{
    int64_t total = 0, of_group = -1, left;
    uint8_t each, place = 0;

    for (each = 0; each < groups_of(type); each++) {
        int64_t found = 0;

        for (; place < end_of(type, each); place++) {
            const int64_t difference = wanted[place] - known[place];

            found += difference * difference;
        }
        total += found;
        if (found > of_group) {
            of_group = found;
            *group = each;
        }
    }
    left = total - of_group;
    *scale = NO_STEP;
    for (each = 0; may_step && each < SCALES; each++) {
        int64_t error = 0;

        for (place = 0; place < type->part_sums; place++) {
            const int32_t difference = wanted[place] - known[place];
            const int64_t rest = difference - digit_of(type, difference, scales[each]) * scales[each];

            error += rest * rest;
        }
        if (error < left || (*scale == NO_STEP && error == left)) { /* a set has to be better */
            left = error;
            *scale = each;
        }
    }
    return total - left;
}

/* Write the sums of a part in whole units; return what its word has to take from the squares, below 0 for nothing. */
static double look(const skin_steps *steps, uint8_t first, const float *variance_n2, int32_t *wanted)
{
    const uint8_t count = steps->board->type->part_sums;
    const double share_n = SKIN_NOISE_RATIO * steps->filter.noise_n;
    double variance = 0, worth_n2;
    uint8_t sum;

    for (sum = first; sum < first + count; sum++) {
        const double units = rint((double)steps->filter.sums_n[sum] / SKIN_UNIT_N);
        const double least = least_of(sum), most = sum == 0 ? SKIN_FIRST_MAX : SKIN_OTHER_MAX;

        wanted[sum] = (int32_t)(units < least ? least : units > most ? most : units);
        variance += (double)variance_n2[sum];
    }
    worth_n2 = count * SKIN_BLOCK_SUMS * (share_n * share_n) + SKIN_VARIANCE_RATIO * variance;
    return steps->quiet == 0 ? -1 : (double)steps->quiet * (worth_n2 / (SKIN_UNIT_N * SKIN_UNIT_N) + count);
}

/* Slots after which their numbers come again. */
static uint16_t cycle_of(uint8_t slots)
{
    uint8_t high = SKIN_HIGH;

    while (SKIN_HIGH % high != 0 || slots % high != 0) {
        high--;
    }
    return (uint16_t)(SKIN_SYNC_OVERFLOW * high);
}

/* Slots from one to the other. */
static uint16_t between(int32_t from, int32_t to, uint16_t cycle)
{
    const int32_t apart = (to - from) % cycle;

    return (uint16_t)(apart < 0 ? apart + cycle : apart);
}

/* Make the words of a frame for a slot; tell whether the frame is worth its bits, or is to be sent all the same. */
static int offer(skin_steps *steps, uint8_t number, const float *variance_n2, uint16_t slot, uint16_t cycle)
{
    const skin_type *type = steps->board->type;
    skin_way *way = &steps->ways[number];
    const uint16_t since = between(way->slot, slot, cycle);
    const uint8_t from = (uint8_t)(type->frame_parts * number), is_set = way->unset < groups_of(type);
    uint8_t scale[SKIN_PARTS] = {0}, group[SKIN_PARTS] = {0}, part;
    uint8_t is_check = !is_set && way->unchecked >= SKIN_CHECK_EVERY;
    int32_t wanted[SKIN_BLOCK_SUMS];
    double least = 0;
    int64_t gain = 0;

    for (part = from; part < from + type->frame_parts; part++) {
        const uint8_t first = (uint8_t)(type->part_sums * part);

        least += look(steps, first, variance_n2, wanted);
        gain += best(type, &wanted[first], &steps->known[first], since <= SKIN_SEQUENCE, &scale[part], &group[part]);
        if (is_set) {
            scale[part] = NO_STEP;
            group[part] = way->unset;
        }
    }
    if (is_set) {
        way->unset++;
    } else if (!is_check && (double)gain > least) {
        way->keep = SKIN_KEEP_MIN;
    } else if (is_check || since >= way->keep) {
        const uint16_t most = cycle / 2 < SKIN_KEEP_MAX ? (uint16_t)(cycle / 2) : SKIN_KEEP_MAX;

        is_check = 1;
        way->keep = 2 * way->keep < most ? (uint16_t)(2 * way->keep) : most;
    } else {
        return 0;
    }
    way->slot = (int16_t)slot;
    for (part = from; part < from + type->frame_parts; part++) {
        const uint8_t first = (uint8_t)(type->part_sums * part);
        int32_t *known = &steps->known[first];

        steps->word[part] = is_check                 ? check_word(type, known, way)
                            : scale[part] == NO_STEP ? set(type, first, &wanted[first], known, group[part], way)
                                                     : step(type, &wanted[first], known, scale[part], way);
    }
    way->sent = (uint16_t)((way->sent + 1) % SKIN_COUNT);
    way->unchecked = is_check ? 0 : (uint8_t)(way->unchecked + (way->unchecked < SKIN_CHECK_EVERY));
    return 1;
}

/* Slots that have begun since the SYNC, the first of them 0; -1: none. */
static int64_t slots_since(const skin_steps *steps, int64_t time_ns)
{
    const int64_t since_ns = time_ns - steps->sync_ns - 1000 * (int64_t)steps->offset_us;

    return since_ns < 0 ? -1 : since_ns * steps->slots / SKIN_SYNC_PERIOD_NS;
}

uint8_t skin_steps_choose(skin_steps *steps, int64_t now_ns)
{
    const uint16_t cycle = cycle_of(steps->slots), turn = cycle / 4 < steps->slots ? (uint16_t)(cycle / 4) : steps->slots;
    const int64_t since = slots_since(steps, now_ns);
    const int is_new = since != slots_since(steps, steps->done_ns);
    float variance_n2[SKIN_BLOCK_SUMS];
    uint16_t slot;
    uint8_t number, chosen = 0;

    steps->done_ns = now_ns;
    if (!steps->is_operational || steps->counter == 0 || since < 0 || since >= 2 * steps->slots || !is_new) {
        return 0;
    }
    slot = (uint16_t)(((steps->counter - 1) * steps->slots + since) % cycle);
    skin_filter_variance(&steps->filter, variance_n2);
    for (number = 0; number < steps->board->type->tpdos; number++) {
        skin_way *way = &steps->ways[number];

        /* The slots of a part's words rise, though a SYNC that was late repeats their numbers. */
        if (way->cob_id == 0 || (way->slot >= 0 && between(slot, way->slot, cycle) < turn) || way->held_until_ns > now_ns) {
            continue;
        }
        if (way->held_until_ns > 0) {
            skin_steps_done(steps, number, 0);
        }
        if (offer(steps, number, variance_n2, slot, cycle)) {
            way->held_until_ns = now_ns + SKIN_LOST_NS;
            chosen = (uint8_t)(chosen | 1u << number);
        }
    }
    return chosen;
}

void skin_steps_done(skin_steps *steps, uint8_t number, int was_sent)
{
    steps->ways[number].held_until_ns = 0;
    steps->ways[number].unset = was_sent ? steps->ways[number].unset : 0;
}

uint8_t skin_steps_payload(const skin_steps *steps, uint8_t number, uint8_t *payload)
{
    const skin_type *type = steps->board->type;
    const uint64_t *words = &steps->word[type->frame_parts * number];
    uint8_t place;

    memset(payload, 0, type->frame_bytes);
    payload[0] = (uint8_t)(steps->ways[number].slot % SKIN_SYNC_OVERFLOW + 1);
    for (place = 0; place < SKIN_WORD_BYTES * type->frame_parts; place++) {
        payload[1 + place] = (uint8_t)(words[place / SKIN_WORD_BYTES] >> 8 * (place % SKIN_WORD_BYTES));
    }
    return type->frame_bytes;
}

static void ask(skin_steps *steps)
{
    uint8_t number;

    for (number = 0; number < steps->board->type->tpdos; number++) {
        steps->ways[number].unset = 0;
    }
}

void skin_steps_forget(skin_steps *steps)
{
    uint8_t number;

    memset(steps->known, 0, sizeof steps->known);
    memset(steps->word, 0, sizeof steps->word);
    memset(steps->ways, 0, sizeof steps->ways);
    for (number = 0; number < steps->board->type->tpdos; number++) {
        steps->ways[number].slot = -1;
        steps->ways[number].keep = SKIN_KEEP_MIN;
    }
    steps->is_operational = 0;
}

void skin_steps_operate(skin_steps *steps, uint8_t is_operational)
{
    if (is_operational && !steps->is_operational) {
        ask(steps);
    }
    steps->is_operational = is_operational;
}

void skin_steps_sync(skin_steps *steps, uint8_t counter, int64_t time_ns)
{
    steps->counter = counter;
    steps->sync_ns = time_ns;
    steps->done_ns = steps->done_ns < time_ns ? steps->done_ns : time_ns - 1;
}

int skin_steps_take(skin_steps *steps, const uint16_t *counts, uint8_t pattern)
{
    steps->filter.taxels = steps->board->held;
    steps->filter.shows_pattern = pattern != 0;
    return skin_filter_take(&steps->filter, counts);
}

int skin_steps_read(const skin_steps *steps, uint16_t index, uint8_t subindex, uint64_t *value)
{
    const skin_filter *filter = &steps->filter;
    uint32_t bits;
    float real;
    uint8_t number;

    *value = 0;
    if (index == SKIN_OD_SYNC_COUNTER) {
        *value = steps->ways[0].slot < 0 ? 0 : (uint64_t)(steps->ways[0].slot % SKIN_SYNC_OVERFLOW + 1);
        return 1;
    }
    if (index == SKIN_OD_REFRESH) {
        for (number = 0; number < steps->board->type->tpdos; number++) {
            *value |= steps->ways[number].unset < groups_of(steps->board->type);
        }
        return 1;
    }
    if (index != SKIN_OD_NODE_NOISE && subindex == 0) {
        return 0;
    }
    if (index == SKIN_OD_WORDS) {
        *value = steps->word[subindex - 1];
        return 1;
    }
    if (index == SKIN_OD_NODE_NOISE) {
        real = (float)filter->noise_n;
    } else if (index == SKIN_OD_COEFFICIENT_NOISE || index == SKIN_OD_TAXEL_NOISE) {
        real = (index == SKIN_OD_TAXEL_NOISE ? filter->taxel_n : filter->coefficient_n)[subindex - 1];
    } else {
        return 0;
    }
    memcpy(&bits, &real, sizeof bits);
    *value = bits;
    return 1;
}

void skin_steps_write(skin_steps *steps, uint16_t index, uint8_t subindex, uint32_t value)
{
    skin_filter *filter = &steps->filter;

    if (index == SKIN_OD_REFRESH && value != 0) {
        ask(steps);
    } else if (index == SKIN_OD_SENDING && subindex == 1) {
        memcpy(&steps->quiet, &value, sizeof value);
    } else if (index == SKIN_OD_SENDING && subindex == 2) {
        steps->slots = (uint8_t)value;
    } else if (index == SKIN_OD_SENDING) {
        steps->offset_us = value;
    } else if (index == SKIN_OD_COEFFICIENT_NOISE || index == SKIN_OD_TAXEL_NOISE) {
        float *given_n = index == SKIN_OD_TAXEL_NOISE ? filter->given_taxel_n : filter->given_coefficient_n;

        memcpy(&given_n[subindex - 1], &value, sizeof value);
        skin_filter_give(filter);
    }
}

int skin_steps_allow(uint16_t index, uint8_t subindex, uint32_t value)
{
    float real;

    memcpy(&real, &value, sizeof real);
    switch (index) {
    case SKIN_OD_REFRESH:
        return value <= 1;
    case SKIN_OD_SENDING:
        return subindex == 1 ? 0 <= real && real < INFINITY : subindex > 2 || (1 <= value && value <= SKIN_SYNC_OVERFLOW);
    case SKIN_OD_COEFFICIENT_NOISE:
    case SKIN_OD_TAXEL_NOISE:
        return real == 0 || (SKIN_LEAST_GIVEN_NOISE_N <= real && real <= SKIN_MOST_GIVEN_NOISE_N);
    default:
        return 1;
    }
}
