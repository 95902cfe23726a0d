/* What one board of a skin is made for. A board's constants are in its board.c. */
#ifndef SKIN_BOARD_H
#define SKIN_BOARD_H

#include <stdint.h>

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
    uint8_t flags;   /* SKIN_OBJECT_... */
    uint16_t at;     /* place of the value in `values` (little endian), first byte */
    uint8_t bytes;   /* length of the value */
} skin_object;

#define SKIN_OBJECT_WRITABLE 0x01u  /* SDO may write; else read only */
#define SKIN_OBJECT_MAPPABLE 0x02u  /* PDOs may carry it */
#define SKIN_OBJECT_COVERED 0x04u   /* the configuration signature (2006h) covers it */
#define SKIN_OBJECT_TEXT 0x08u      /* of variable length, no number */

/* Objects of a board. */
#define SKIN_OD_SIGNATURE 0x2006u
#define SKIN_OD_HEALTH 0x2020u
/* Of the first block; those of each further block are SKIN_OD_BLOCK_STRIDE higher. */
#define SKIN_OD_GAIN 0x2010u
#define SKIN_OD_OFFSET 0x2011u
#define SKIN_OD_PATTERN 0x2021u
#define SKIN_OD_SUMS 0x2100u
#define SKIN_OD_BLOCK_STRIDE 0x200u
/* Of adaptive boards. */
#define SKIN_OD_REFRESH 0x2030u
#define SKIN_OD_SENDING 0x2031u
#define SKIN_OD_COEFFICIENT_NOISE 0x2032u
#define SKIN_OD_TAXEL_NOISE 0x2033u
#define SKIN_OD_BUDGET 0x2034u
#define SKIN_OD_NODE_NOISE 0x2035u
#define SKIN_OD_COARSE 0x2110u
#define SKIN_OD_FINE 0x2111u

/* One board. All arrays are constant and may stay in flash memory. */
typedef struct {
    uint8_t node_id;
    uint8_t blocks;              /* blocks of taxels */
    uint16_t block_size;         /* taxels of a block, a power of two, 2 to 128 */
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
