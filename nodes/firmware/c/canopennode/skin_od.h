/* The objects that every board has, in the dictionary of CANopenNode V4: signature, calibration, test patterns, health. */
#ifndef SKIN_OD_H
#define SKIN_OD_H

#include "301/CO_ODinterface.h"
#include "board.h"
#include "skin_average.h"

typedef ODR_t skin_od_reader(OD_stream_t *, void *, OD_size_t, OD_size_t *);
typedef ODR_t skin_od_writer(OD_stream_t *, const void *, OD_size_t, OD_size_t *);

/* The board of this image that runs: the first, until skin_app_choose. */
extern const skin_board *skin_od_board;
extern skin_block skin_od_blocks[SKIN_BLOCKS];
/* 2020h: SYNCs received, TPDOs sent, TPDOs dropped, saturated taxels. */
extern uint32_t *skin_od_health;

/* Connect signature, calibration, counts and patterns with the dictionary. Returns 0 on success. */
int skin_od_connect(void);

/* End test patterns, and begin to count anew. */
void skin_od_reset(void);

/* Where a value of the dictionary is, NULL if there is none of that length. */
void *skin_od_value(uint16_t index, uint8_t subindex, OD_size_t length);

/* Pass reads and writes of an object to functions; tell whether that failed. */
int skin_od_extend(OD_extension_t *extension, uint16_t index, skin_od_reader *read, skin_od_writer *write);

/* Answer a read with a number of `bytes` bytes. */
ODR_t skin_od_put(uint64_t value, uint8_t bytes, void *buf, OD_size_t count, OD_size_t *countRead);

#endif
