#include "skin_canopennode.h"

#if !SKIN_STEPPED

#include <stddef.h>

#include "skin_od.h"
#include "skin_sums.h"

static void *sums[SKIN_BLOCKS]; /* raw values, of 8 or 16 bits */
static uint8_t *sync_counter;   /* 2022h; NULL of a board without sums */
#if SKIN_SAMPLES > 1
static skin_average averages[SKIN_BLOCKS];
#endif

static uint16_t sums_of(uint8_t block)
{
    return (uint16_t)(skin_od_board->type->first_sum[block + 1] - skin_od_board->type->first_sum[block]);
}

int skin_app_init(void)
{
    int failed = skin_od_connect();
    uint8_t block;

    sync_counter = skin_od_value(SKIN_OD_SYNC_COUNTER, 0, sizeof *sync_counter);
    failed |= sync_counter == NULL && skin_od_board->type->tpdos > 0;
    for (block = 0; block < skin_od_board->type->blocks; block++) {
        const uint16_t index = (uint16_t)(SKIN_OD_SUMS + SKIN_BLOCK_STRIDE * block);

        sums[block] = skin_od_value(index, 1, skin_od_board->type->packing.bits <= 8 ? 1 : 2);
        failed |= sums[block] == NULL && sums_of(block) > 0;
#if SKIN_SAMPLES > 1
        skin_forget(&averages[block]);
#endif
    }
    if (!failed) {
        skin_od_reset();
    }
    return failed;
}

void skin_app_sync(skin_reading *readings, uint16_t samples, uint8_t counter)
{
    int32_t found[SKIN_SUMS];
    uint16_t each;
    uint8_t block;

    if (sync_counter != NULL) {
        *sync_counter = counter;
    }
    skin_od_health[0]++;
    skin_od_health[3] = 0;
    for (block = 0; block < skin_od_board->type->blocks; block++) {
        skin_od_health[3] += skin_measure(skin_od_board, block, SKIN_AVERAGE_OF(averages, block), readings, samples,
                                          &skin_od_blocks[block], found);
        for (each = 0; each < sums_of(block); each++) {
            const int32_t raw = skin_raw(&skin_od_board->type->packing, found[each]);

            if (skin_od_board->type->packing.bits <= 8) {
                ((uint8_t *)sums[block])[each] = (uint8_t)raw;
            } else {
                ((uint16_t *)sums[block])[each] = (uint16_t)raw;
            }
        }
    }
}

void skin_app_dropped(void)
{
    skin_od_health[2]++;
}

#endif
