/* What one board of a skin is made for. A board's constants are in its board.c. */
#ifndef SKIN_BOARD_H
#define SKIN_BOARD_H

#include <stdint.h>

#include "contract.h"

/* Conversion of a sum in ADC counts to the value in a PDO: raw = round(sum / 2^step_log2) + offset. */
typedef struct {
    uint8_t bits;       /* width in a PDO: 8, 12 or 16 */
    uint8_t step_log2;  /* binary logarithm of the counts per step */
    uint16_t offset;    /* raw value of a sum of 0; 0: raw values are two's complement */
} skin_packing;

/* One object: an index and a sub-index of the dictionary. */
typedef struct {
    uint16_t index;
    uint8_t subindex;
    uint8_t flags;   /* SKIN_OBJECT_...: SDO may write, PDOs may carry, in 2006h; text of variable length; in 2009h */
    uint16_t at;     /* place of the value in `values` (little endian), first byte, or SKIN_OBJECT_COMPUTED */
    uint8_t bytes;   /* length of the value */
} skin_object;

/* One board. All arrays are constant and may stay in flash memory. */
typedef struct {
    uint8_t node_id;
    uint8_t blocks;              /* blocks of taxels */
    uint16_t block_size;         /* taxels of a block, a power of two, 2 to 128 */
    uint16_t held;               /* taxels of all blocks, without empty places */
    uint16_t count_max;          /* largest ADC count */
    skin_packing packing;
    const uint16_t *first_sum;   /* place of each block's first sum, blocks + 1 entries */
    const uint8_t *rows;         /* Hadamard row of each sum */
    const uint16_t *taxels;      /* row-major index of the taxel at each place of the chain, block after block */
    uint8_t tpdos;               /* TPDO communication records */
    uint8_t pdo_bytes;           /* longest payload of a PDO: 8, or 64 with CAN FD */
    uint8_t frame_flags;         /* of a PDO's frame: SKIN_FRAME_FD, SKIN_FRAME_BRS */
    uint32_t frame_ns;           /* longest time of one of the board's frames on the bus */
    uint16_t frame_bits[2];      /* of adaptive boards: what a coarse and a fine frame take of a budget */
    const skin_object *objects;  /* ascending by index and sub-index */
    uint16_t object_count;
    const uint8_t *values;       /* default values of the objects */
    uint16_t communication_bytes; /* the first bytes of `values`: objects below 2000h that can be written */
    uint16_t writable_bytes;      /* communication_bytes and then the other objects that can be written */
} skin_board;

#endif
