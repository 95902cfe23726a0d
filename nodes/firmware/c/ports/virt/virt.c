/* QEMU's machine virt, Cortex-A15: interrupts, clock, watchdog, switches, flash memory. */
#include "virt.h"

#include "port.h"

enum { ENABLED = 0x100, PRIORITY = 0x400, TARGETS = 0x800 }; /* of the GIC, with a bit or a byte for each interrupt */
enum { CPU_ENABLED = 0x00, LEAST_PRIORITY = 0x04, ACKNOWLEDGE = 0x0C, END = 0x10 };
enum { NONE = 1020 };
#define TICK_COUNTS 62500u /* 1 ms */
#define COUNT_NS 16
#define WATCHDOG_TICKS 300u

static void (*handle)(void);
static volatile uint32_t ticks, alive_at;

uint32_t virt_cpu(void)
{
    uint32_t affinity;

    __asm__ volatile("mrc p15, 0, %0, c0, c0, 5" : "=r"(affinity));
    return affinity & 0xFFu;
}

int64_t port_now_ns(void)
{
    uint32_t low, high;

    __asm__ volatile("mrrc p15, 1, %0, %1, c14" : "=r"(low), "=r"(high)); /* CNTVCT */
    return (int64_t)((uint64_t)high << 32 | low) * COUNT_NS;
}

static void start_tick(void)
{
    __asm__ volatile("mcr p15, 0, %0, c14, c3, 0\n mcr p15, 0, %1, c14, c3, 1\n isb" : : "r"(TICK_COUNTS), "r"(1));
}

uint32_t port_lock(void)
{
    uint32_t before;

    __asm__ volatile("mrs %0, cpsr\n cpsid i" : "=r"(before) : : "memory");
    return before;
}

void port_unlock(uint32_t before)
{
    __asm__ volatile("msr cpsr_c, %0" : : "r"(before) : "memory");
}

void port_idle(int (*has_work)(void))
{
    const uint32_t before = port_lock();

    if (!has_work()) {
        __asm__ volatile("wfi"); /* an interrupt ends the sleep also while interrupts are off */
    }
    port_unlock(before);
}

void virt_interrupts(uint32_t number, void (*handler)(void))
{
    handle = handler;
    virt_put(VIRT_GIC, 1);
    *(volatile uint8_t *)(VIRT_GIC + PRIORITY + number) = 0x80;
    *(volatile uint8_t *)(VIRT_GIC + TARGETS + number) |= (uint8_t)(1u << virt_cpu());
    virt_put(VIRT_GIC + ENABLED + number / 32 * 4, 1u << number % 32);
    *(volatile uint8_t *)(VIRT_GIC + PRIORITY + VIRT_TIMER_INTERRUPT) = 0xC0;
    virt_put(VIRT_GIC + ENABLED, 1u << VIRT_TIMER_INTERRUPT);
    virt_put(VIRT_GIC_CPU + LEAST_PRIORITY, 0xFF);
    virt_put(VIRT_GIC_CPU + CPU_ENABLED, 1);
    start_tick();
    __asm__ volatile("cpsie i");
}

void virt_interrupt(void)
{
    const uint32_t number = virt_get(VIRT_GIC_CPU + ACKNOWLEDGE) & 1023u;

    if (number >= NONE) {
        return;
    }
    if (number == VIRT_TIMER_INTERRUPT) {
        start_tick();
        ticks++;
    } else {
        handle();
    }
    virt_put(VIRT_GIC_CPU + END, number);
    if (ticks - alive_at > WATCHDOG_TICKS) {
        virt_say("watchdog\n");
        port_reset();
    }
}

void port_alive(void)
{
    alive_at = ticks;
}

void virt_say(const char *text)
{
    register uint32_t operation __asm__("r0") = 4; /* SYS_WRITE0 */
    register const char *given __asm__("r1") = text;

    __asm__ volatile("svc 0xab" : "+r"(operation) : "r"(given) : "memory");
}

void virt_fault(uint32_t kind, uint32_t at)
{
    char text[] = "FAULT  at --------\n";
    int each;

    text[6] = (char)('0' + kind);
    for (each = 0; each < 8; each++) {
        text[11 + each] = "0123456789abcdef"[at >> (28 - 4 * each) & 15];
    }
    virt_say(text);
}

uint8_t port_bus(void)
{
    return 0;
}

uint8_t port_node_id(void)
{
    return (uint8_t)virt_get(VIRT_SWITCHES(virt_cpu()));
}

uint32_t port_serial_number(void)
{
    return port_node_id() == 0 ? virt_cpu() : 0;
}

uintptr_t flash_base(void)
{
    return VIRT_FLASH + virt_cpu() * VIRT_FLASH_BOARD_BYTES;
}

/* All boards share one memory, which has one state. */
void flash_take(void)
{
    while (__atomic_exchange_n((uint32_t *)VIRT_FLASH_OWNER, 1, __ATOMIC_ACQUIRE)) {
    }
}

void flash_give(void)
{
    __atomic_store_n((uint32_t *)VIRT_FLASH_OWNER, 0, __ATOMIC_RELEASE);
}

uint8_t port_slot(void)
{
    return (uint8_t)virt_get(VIRT_SLOT(virt_cpu()));
}

static void go(uintptr_t address)
{
    ((void (*)(void))address)();
}

void port_start(uint8_t slot)
{
    uint8_t head[SKIN_PROGRAM_HEAD];
    uint32_t at = SKIN_SLOT_HEAD + SKIN_PROGRAM_HEAD, left;

    if (slot == SKIN_NO_SLOT) {
        virt_say("no program\n");
        return;
    }
    (void)port_programs.read(port_programs.context, slot, SKIN_SLOT_HEAD, head, sizeof head);
    for (left = skin_get(&head[SKIN_PROGRAM_AT_SIZE], 4); left > 0; left--, at++) {
        (void)port_programs.read(port_programs.context, slot, at, (uint8_t *)VIRT_PROGRAM(virt_cpu()) + at - SKIN_SLOT_HEAD - SKIN_PROGRAM_HEAD, 1);
    }
    virt_put(VIRT_SLOT(virt_cpu()), slot);
    go(VIRT_PROGRAM(virt_cpu()));
}

void port_reset(void)
{
    (void)port_lock();
    go(VIRT_BOOTLOADER(virt_cpu()));
}
