/* A board of the machine virt: its controller, and converters that read what a test can know: at each SYNC other counts; of stepped
 * boards noise, and from sample PRESSED_AT on a pressure that stays.
 */
#include "port.h"
#include "virt.h"

#define PRESSED_AT 4096u

void port_open(void)
{
    const uint32_t slot = virt_cpu();

#if VIRT_FD
    can_open(VIRT_MEMORY_OF(slot) + 0x10000u, 80000000u);
#else
    const uintptr_t bridge = VIRT_PCI_PORTS + VIRT_PORTS_OF(slot);

    can_open(bridge + 0x80u, 16000000u);
    virt_put(bridge + 0x38u, virt_get(bridge + 0x38u) | 0x2000u); /* the S5920 passes interrupts on */
#endif
    virt_interrupts(VIRT_PCI_INTERRUPT(slot), can_interrupt);
    virt_say("board up\n");
}

static uint32_t mixed(uint32_t number)
{
    number = (number ^ number >> 15) * 2246822519u;
    return number ^ number >> 13;
}

uint16_t port_convert(const skin_frame *sync, skin_reading *readings)
{
    static uint32_t conversions;
    const uint32_t counter = sync == NULL ? 0 : sync->data[0], first = mixed((conversions * 256u + counter) * 128u + virt_cpu());
    const uint32_t pressure = conversions < PRESSED_AT ? 0 : 16u * virt_cpu();
    uint32_t each;

    for (each = 0; each < SKIN_READINGS; each++) {
        const uint32_t drawn = mixed(first + each);

        readings[each] = (skin_reading)(sync == NULL ? (drawn >> 30) + pressure * (each % 8u) : drawn >> 8 & 1023u);
    }
    conversions++;
    return 1;
}
