/* Many boards of board.c in one library: frames, times and taxel counts in, frames out. The caller owns the memory. */
#ifndef SKIN_BOARDS_H
#define SKIN_BOARDS_H

#include "skin_node.h"

/* Two cycles: the boards may miss a SYNC. */
#define SKIN_MOST_SAMPLES (2 * SKIN_SAMPLES)

/* Power up `boards` boards, from board `first` of board.c on; `nodes` has room for them, `storages` has that of each or is
 * NULL, `flashes` have their programs. `unnumbered` boards wait for LSS, unless their storage has a node-ID.
 *
 * Returns the number of frames written to `out`, at most `capacity`; so do the two functions below.
 */
size_t skin_power_up(skin_node *nodes, uint32_t first, uint32_t boards, const skin_storage *storages,
                     const skin_flash *flashes, int unnumbered, uint32_t now_ms, skin_frame *out, size_t capacity);

/* Pass received frames to the boards of one bus.
 *
 * readings: what the converters of these boards read since the last SYNC, `stride` values a sample; 1 to SKIN_MOST_SAMPLES
 * `samples`, the last at the SYNC among the frames; NULL without a SYNC. The frames hold one SYNC at most.
 */
size_t skin_take(skin_node *nodes, uint32_t boards, uint32_t now_ms, const skin_reading *readings, uint16_t samples,
                 uint32_t stride, const skin_frame *frames, size_t count, skin_frame *out, size_t capacity);

/* Take note of TPDOs that found no room in the transmit queue; returns `count`. */
size_t skin_refuse(skin_node *nodes, uint32_t boards, const skin_frame *frames, size_t count);

#if SKIN_STEPPED

/* Connect `boards` boards, from board `first` of board.c on, with their constants; samples come before skin_power_up. */
void skin_prepare(skin_node *nodes, uint32_t first, uint32_t boards, const skin_storage *storages);

/* Pass one sample to the boards: SKIN_BLOCK_SUMS counts of each board; overwritten. Returns how many boards are ready to boot. */
size_t skin_take_counts(skin_node *nodes, uint32_t boards, uint16_t *counts);

/* Make the frames of the slots of boards that have begun; returns their number. */
size_t skin_choose(skin_node *nodes, uint32_t boards, int64_t now_ns, skin_frame *out, size_t capacity);

/* Number of frames that a controller may hold. */
size_t skin_under_way(const skin_node *nodes, uint32_t boards);

#endif

/* Do what is due by time. */
size_t skin_pass_time(skin_node *nodes, uint32_t boards, uint32_t now_ms, skin_frame *out, size_t capacity);

/* Bytes of a skin_node. */
size_t skin_node_bytes(void);

#endif
