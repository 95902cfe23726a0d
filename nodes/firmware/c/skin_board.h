/* What the boards of an image are made for: one board, or all boards of a type. Their constants are in board.c. */
#ifndef SKIN_BOARD_H
#define SKIN_BOARD_H

#include <stdint.h>

#include "contract.h"

/* Conversion of a sum in ADC counts to the value in a PDO: raw = round(sum / 2^step_log2) + offset. */
typedef struct {
    uint8_t bits;       /* width in a PDO: 7 to 16 */
    uint8_t step_log2;  /* binary logarithm of the counts per step */
    uint16_t offset;    /* raw value of a sum of 0; 0: raw values are two's complement */
} skin_packing;

/* One object: an index and a sub-index of the dictionary. */
typedef struct {
    uint16_t index;
    uint8_t subindex;
    uint8_t flags;   /* SKIN_OBJECT_...: SDO may write, PDOs may carry, in 2006h and 2009h, in 2009h alone */
    uint16_t at;     /* place of the value in `values` (little endian), first byte, or SKIN_OBJECT_COMPUTED */
    uint8_t bytes;   /* length of the value */
} skin_object;

/* What the boards of a type share. All arrays are constant and may stay in flash memory. */
typedef struct {
    uint8_t blocks;              /* blocks of taxels */
    uint16_t block_size;         /* taxels of a block, a power of two, 2 to 128 */
    uint16_t count_max;          /* largest ADC count */
    skin_packing packing;
    const uint16_t *first_sum;   /* place of each block's first sum, blocks + 1 entries */
    uint8_t tpdos;               /* TPDO communication records */
    uint8_t pdo_bytes;           /* longest payload of a PDO: 8, or 64 with CAN FD */
    uint8_t frame_flags;         /* of a PDO's frame: SKIN_FRAME_FD, SKIN_FRAME_BRS */
    uint32_t frame_ns;           /* longest time of one of the board's frames on the bus */
    uint8_t frame_bytes;         /* of stepped boards: payload of a frame, */
    uint8_t frame_parts;         /* words in it, */
    uint8_t part_sums, radix;    /* sums of a word, values of a digit, */
    uint64_t steps;              /* and number of words that are steps */
    const skin_object *objects;  /* ascending by index and sub-index */
    uint16_t object_count;
    uint16_t communication_bytes; /* the first places of values: objects below 2000h that can be written */
    uint16_t writable_bytes;      /* communication_bytes and then the other objects that can be written */
    uint16_t own_first;           /* the first places of all, and */
    uint16_t own_from, own_middle; /* from own_from as many around writable_bytes: values that each board has for itself */
    const uint8_t *values;        /* default values at the other places */
} skin_type;

/* One board of an image. */
typedef struct {
    uint8_t bus;          /* number of the bus in the layout */
    uint8_t node_id;
    uint16_t held;        /* taxels of all blocks, without empty places */
    const skin_type *type;
    const uint8_t *own;   /* own_first and then own_middle bytes of values */
} skin_board;

/* Hadamard row of each sum of a board (2003h): the first of its own constants, behind its own settings. */
#define SKIN_ROWS(board) \
    ((board)->own + (board)->type->own_first + (board)->type->writable_bytes - (board)->type->own_from)

/* The board of this image with a node-ID on a bus, NULL if there is none. */
const skin_board *skin_board_of(uint8_t bus, uint8_t node_id);

/* The default value at a place, and whether it is one of the board's own. */
const uint8_t *skin_default(const skin_board *board, uint16_t at);
int skin_is_own(const skin_type *type, uint16_t at);

#endif
