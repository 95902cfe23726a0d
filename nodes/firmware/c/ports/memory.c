/* What a compiler calls of a C library, byte by byte: no access has to be aligned. */
#include <stddef.h>

void *memcpy(void *to, const void *from, size_t bytes)
{
    size_t each;

    for (each = 0; each < bytes; each++) {
        ((char *)to)[each] = ((const char *)from)[each];
    }
    return to;
}

void *memmove(void *to, const void *from, size_t bytes)
{
    if ((const char *)to < (const char *)from) {
        return memcpy(to, from, bytes);
    }
    while (bytes-- > 0) {
        ((char *)to)[bytes] = ((const char *)from)[bytes];
    }
    return to;
}

void *memset(void *to, int value, size_t bytes)
{
    while (bytes-- > 0) {
        ((char *)to)[bytes] = (char)value;
    }
    return to;
}

int memcmp(const void *one, const void *other, size_t bytes)
{
    const unsigned char *left = one, *right = other;

    for (; bytes > 0; bytes--, left++, right++) {
        if (*left != *right) {
            return *left < *right ? -1 : 1;
        }
    }
    return 0;
}
