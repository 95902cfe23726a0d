/* What a USB adapter's firmware does: slcan between a terminal and a CAN controller. It also starts the boards' processors, sets up
 * the PCI bus that no firmware has set up, and disturbs: L drops SYNCs, W writes a word to the memory of all.
 */
#include "port.h"
#include "virt.h"

#ifndef BOARDS
#define BOARDS 3u
#endif
#define VIRT_UART 0x09000000u
#define VIRT_UART_INTERRUPT 33u
#define VIRT_PCI_CONFIG 0x3F000000u
/* The bus of the emulator takes no time; a frame of 1 Mbit/s does. */
#define FRAME_NS 55000
#define BYTE_NS 10000
enum { UART_DATA = 0x00, UART_FLAGS = 0x18, UART_LINE = 0x2C, UART_CONTROL = 0x30, UART_INTERRUPTS = 0x38 };
enum { IS_EMPTY = 1 << 4, IS_FULL = 1 << 5 };
enum { KVASER = 0x840610E8, CTUCAN = 0xFF001760 };

static const uint8_t lengths[] = SKIN_FD_LENGTHS;
static volatile uint8_t typed[4096];
static volatile uint32_t typed_first, typed_end;
static uint32_t syncs_to_lose;
static int is_open;

void port_received(skin_frame *frame)
{
    (void)queue_put(frame);
}

static void interrupted(void)
{
    can_interrupt();
    while ((virt_get(VIRT_UART + UART_FLAGS) & IS_EMPTY) == 0) {
        typed[typed_end++ % sizeof typed] = (uint8_t)virt_get(VIRT_UART + UART_DATA);
    }
}

static int has_work(void)
{
    return queue_waits() || typed_first != typed_end;
}

static void put(int character)
{
    while ((virt_get(VIRT_UART + UART_FLAGS) & IS_FULL) != 0) {
    }
    virt_put(VIRT_UART + UART_DATA, (uint8_t)character);
}

static void put_hex(uint32_t value, int digits)
{
    while (digits-- > 0) {
        put("0123456789ABCDEF"[value >> 4 * digits & 15u]);
    }
}

static uint32_t hex(const char *text, int digits)
{
    uint32_t value = 0;

    for (; digits > 0; digits--, text++) {
        value = value << 4 | (uint32_t)(*text <= '9' ? *text - '0' : (*text | 0x20) - 'a' + 10);
    }
    return value;
}

static void send(const char *line)
{
    const int64_t began_ns = port_now_ns();
    skin_frame frame = {0};
    int each;

    frame.can_id = hex(&line[1], 3);
    frame.length = lengths[hex(&line[4], 1)];
    frame.flags = (uint8_t)(line[0] == 't' ? 0 : line[0] == 'b' ? SKIN_FRAME_FD | SKIN_FRAME_BRS : SKIN_FRAME_FD);
    for (each = 0; each < frame.length; each++) {
        frame.data[each] = (uint8_t)hex(&line[5 + 2 * each], 2);
    }
    if (frame.can_id == SKIN_SYNC_COB_ID && syncs_to_lose > 0) {
        syncs_to_lose--;
        return;
    }
    while (!queue_send(&frame)) {
    }
    while (port_now_ns() - began_ns < FRAME_NS + BYTE_NS * frame.length) {
    }
}

static void obey(const char *line)
{
    const char *text = "V1013";

    switch (line[0]) {
    case 't':
    case 'd':
    case 'b':
        send(line);
        return;
    case 'L':
        syncs_to_lose = hex(&line[1], 2);
        return;
    case 'W':
        virt_put(hex(&line[1], 8), hex(&line[9], 8));
        return;
    case 'V':
        while (*text != 0) {
            put(*text++);
        }
        break;
    case 'O':
    case 'C':
        is_open = line[0] == 'O';
        break;
    default:
        break;
    }
    put('\r');
}

static void show(const skin_frame *frame)
{
    uint32_t code = 0;
    int each;

    while (lengths[code] < frame->length) {
        code++;
    }
    put((frame->flags & SKIN_FRAME_FD) != 0 ? 'b' : 't');
    put_hex(frame->can_id, 3);
    put_hex(code, 1);
    for (each = 0; each < frame->length; each++) {
        put_hex(frame->data[each], 2);
    }
    put('\r');
}

/* Ports and memory for the controllers: what a PC's firmware does. */
static void set_up_bus(void)
{
    uint32_t slot;

    for (slot = 1; slot <= BOARDS + 1; slot++) {
        const uintptr_t config = VIRT_PCI_CONFIG + (slot << 15);
        const uint32_t device = virt_get(config);

        if (device == CTUCAN) {
            virt_put(config + 0x10, VIRT_MEMORY_OF(slot));
            virt_put(config + 0x14, VIRT_MEMORY_OF(slot) + 0x10000u);
        } else if (device == KVASER) {
            virt_put(config + 0x10, VIRT_PORTS_OF(slot));
            virt_put(config + 0x14, VIRT_PORTS_OF(slot) + 0x80u);
            virt_put(config + 0x18, VIRT_PORTS_OF(slot) + 0x100u);
        }
        virt_put(config + 4, virt_get(config + 4) | 3u);
    }
}

static void start_boards(void)
{
    uint32_t cpu;

    for (cpu = 1; cpu <= BOARDS; cpu++) {
        register uint32_t r0 __asm__("r0") = 0x84000003u; /* PSCI CPU_ON */
        register uint32_t r1 __asm__("r1") = cpu;
        register uint32_t r2 __asm__("r2") = VIRT_BOOTLOADER(cpu);
        register uint32_t r3 __asm__("r3") = 0;

        __asm__ volatile(".arch_extension virt\n hvc #0" : "+r"(r0) : "r"(r1), "r"(r2), "r"(r3) : "memory");
    }
}

int main(void)
{
    static char line[160];
    uint32_t length = 0;
    skin_frame frame;

    set_up_bus();
    can_open(VIRT_MEMORY_OF(BOARDS + 1) + 0x10000u, 80000000u);
    virt_put(VIRT_UART + UART_LINE, 0x70);
    virt_put(VIRT_UART + UART_CONTROL, 0x301);
    virt_put(VIRT_UART + UART_INTERRUPTS, 0x50);
    virt_interrupts(VIRT_PCI_INTERRUPT(BOARDS + 1), interrupted);
    virt_interrupts(VIRT_UART_INTERRUPT, interrupted);
    start_boards();
    for (;;) {
        while (typed_first != typed_end) {
            const char character = (char)typed[typed_first++ % sizeof typed];

            if (character != '\r') {
                line[length++ % sizeof line] = character;
            } else {
                if (length > 0) {
                    obey(line);
                }
                length = 0;
            }
        }
        while (queue_outcome(&frame)) {
        }
        while (queue_take(&frame)) {
            if (is_open) {
                show(&frame);
            }
        }
        port_alive();
        port_idle(has_work);
    }
}
