/* Parallel NOR flash by the commands of Intel (CFI 01): two devices of 16 bits side by side, a sector for each slot. */
#include "port.h"

enum { PROGRAM = 0x40, ERASE = 0x20, CONFIRM = 0xD0, CLEAR_STATUS = 0x50, READ = 0xFF, READY = 0x80, ERRORS = 0x3A };
/* A byte for both devices. */
#define BOTH(byte) ((uint32_t)(byte) << 16 | (byte))

static void put(uintptr_t at, uint32_t word)
{
    *(volatile uint32_t *)at = word;
}

static uint32_t get(uintptr_t at)
{
    return *(volatile uint32_t *)at;
}

static uintptr_t place_of(const void *context, uint8_t slot, uint32_t at)
{
    return flash_base() + (uintptr_t)context + slot * FLASH_SECTOR_BYTES + at;
}

/* Give a command with its word, and wait for the end. */
static void run(uintptr_t at, uint32_t command, uint32_t word)
{
    put(at, command);
    put(at, word);
    while ((get(at) & BOTH(READY)) != BOTH(READY)) {
    }
}

/* Leave the memory readable; returns 0 if all commands have succeeded. */
static int end(uintptr_t at)
{
    const uint32_t errors = get(at) & BOTH(ERRORS);

    put(at, BOTH(CLEAR_STATUS));
    put(at, BOTH(READ));
    flash_give();
    return errors != 0;
}

static int erase(void *context, uint8_t slot)
{
    const uintptr_t at = place_of(context, slot, 0);

    flash_take();
    run(at, BOTH(ERASE), BOTH(CONFIRM));
    return end(at);
}

static int write(void *context, uint8_t slot, uint32_t at, const uint8_t *data, uint16_t bytes)
{
    const uintptr_t first = place_of(context, slot, at);
    uint32_t each, byte;

    flash_take();
    for (each = 0; each < bytes; each += 4) {
        uint32_t word = 0xFFFFFFFFu;

        for (byte = 0; byte < 4 && each + byte < bytes; byte++) {
            word &= ~((uint32_t)(uint8_t)~data[each + byte] << 8 * byte);
        }
        run(first + each, BOTH(PROGRAM), word);
    }
    return end(first);
}

static int read(void *context, uint8_t slot, uint32_t at, uint8_t *data, uint16_t bytes)
{
    const volatile uint8_t *from = (const volatile uint8_t *)place_of(context, slot, at);
    uint16_t each;

    flash_take();
    for (each = 0; each < bytes; each++) {
        data[each] = from[each];
    }
    flash_give();
    return 0;
}

/* Sectors 0 and 1 hold programs, those behind them the records. */
const skin_flash port_programs = {erase, write, read, FLASH_SECTOR_BYTES, (void *)0};
const skin_flash port_records = {erase, write, read, FLASH_SECTOR_BYTES, (void *)(2 * FLASH_SECTOR_BYTES)};
