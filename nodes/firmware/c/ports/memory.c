/* What a compiler calls of a C library, byte by byte: no access has to be aligned. */
#include <stddef.h>

void *memmove(void *to, const void *from, size_t bytes)
{
    char *written = to;
    const char *read = from;
    size_t each;

    for (each = 0; each < bytes && written <= read; each++) {
        written[each] = read[each];
    }
    while (written > read && bytes-- > 0) {
        written[bytes] = read[bytes];
    }
    return to;
}

void *memcpy(void *to, const void *from, size_t bytes)
{
    return memmove(to, from, bytes);
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

    for (; bytes > 0 && *left == *right; bytes--, left++, right++) {
    }
    return bytes == 0 ? 0 : *left - *right;
}
