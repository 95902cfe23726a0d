/* Numbers as little endian bytes, and times that wrap. */
#ifndef SKIN_BYTES_H
#define SKIN_BYTES_H

#include <stdint.h>

uint32_t skin_get(const uint8_t *data, uint8_t bytes);
void skin_put(uint8_t *data, uint32_t value, uint8_t bytes);

/* Whether a time has come; both may have wrapped. */
static inline int skin_is_due(uint32_t now_ms, uint32_t due_ms)
{
    return now_ms - due_ms < 0x80000000u;
}

#endif
