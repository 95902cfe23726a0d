#include "skin_bytes.h"

uint32_t skin_get(const uint8_t *data, uint8_t bytes)
{
    uint32_t value = 0;

    while (bytes-- > 0) {
        value = (value << 8) | data[bytes];
    }
    return value;
}

void skin_put(uint8_t *data, uint32_t value, uint8_t bytes)
{
    uint8_t place;

    for (place = 0; place < bytes; place++) {
        data[place] = (uint8_t)(value >> (8 * place));
    }
}
