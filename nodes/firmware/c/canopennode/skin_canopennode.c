#include "skin_canopennode.h"

#if !SKIN_ADAPTIVE

#include <stddef.h>
#include <string.h>

#include "skin_average.h"
#include "skin_od.h"
#include "skin_sums.h"

static void *sums[SKIN_BLOCKS]; /* raw values, of 8 or 16 bits */
#if SKIN_SAMPLES > 1
static skin_average states[SKIN_BLOCKS];
#endif

int skin_app_init(void)
{
    int failed = skin_od_connect();
    uint8_t block;

    for (block = 0; block < skin_od_board->type->blocks; block++) {
        const uint16_t index = (uint16_t)(SKIN_OD_SUMS + SKIN_BLOCK_STRIDE * block);

        sums[block] = skin_od_value(index, 1, skin_od_board->type->packing.bits == 8 ? 1 : 2);
        failed |= sums[block] == NULL;
#if SKIN_SAMPLES > 1
        skin_forget(&states[block]);
#endif
    }
    if (!failed) {
        skin_od_reset();
    }
    return failed;
}

void skin_app_sync(uint16_t *counts, uint16_t samples)
{
    int32_t found[SKIN_SUMS];
    uint16_t each;
    uint8_t block;

    skin_od_health[0]++;
    skin_od_health[3] = 0;
    for (block = 0; block < skin_od_board->type->blocks; block++) {
        skin_od_health[3] += skin_measure(skin_od_board, block, SKIN_AVERAGE_OF(states, block), counts, samples,
                                          skin_od_blocks[block].gain, skin_od_blocks[block].offset,
                                          *skin_od_blocks[block].pattern, found);
        memcpy(skin_od_blocks[block].counts,
               &counts[((uint32_t)(samples - 1) * skin_od_board->type->blocks + block) * skin_od_board->type->block_size],
               skin_od_board->type->block_size * sizeof counts[0]);
        for (each = 0; each < skin_od_board->type->first_sum[block + 1] - skin_od_board->type->first_sum[block]; each++) {
            const int32_t raw = skin_raw(&skin_od_board->type->packing, found[each]);

            if (skin_od_board->type->packing.bits == 8) {
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
