/* Addresses of QEMU's machine virt (highmem=off, GIC version 2) with a CAN controller in each slot of its PCI bus from 1 on. Processor n
 * is the board of slot n; each has a megabyte for its program and one for its bootloader.
 */
#ifndef VIRT_H
#define VIRT_H

#include <stdint.h>

#define VIRT_GIC 0x08000000u
#define VIRT_GIC_CPU 0x08010000u
#define VIRT_FLASH 0x04000000u
#define VIRT_FLASH_BOARD_BYTES 0x200000u
#define VIRT_PCI_PORTS 0x3EFF0000u
#define VIRT_PORTS_OF(slot) (0x1000u + (slot) * 0x200u) /* kvaser_pci: bridge, SJA1000, Xilinx */
#define VIRT_MEMORY_OF(slot) (0x10000000u + (slot) * 0x20000u) /* ctucan_pci: bridge, cores */
#define VIRT_PCI_INTERRUPT(slot) (32u + 3u + (slot) % 4u)
#define VIRT_TIMER_INTERRUPT 27u
#define VIRT_PROGRAM(cpu) (0x41000000u + (cpu) * 0x100000u)
#define VIRT_BOOTLOADER(cpu) (0x42000000u + (cpu) * 0x100000u)
/* Words of each board: the switches, set before power-up; the slot that the bootloader has started; and of all: who has the flash memory. */
#define VIRT_SWITCHES(cpu) (0x43000000u + (cpu) * 0x100u)
#define VIRT_SLOT(cpu) (0x43000010u + (cpu) * 0x100u)
#define VIRT_FLASH_OWNER 0x43000000u

static inline uint32_t virt_get(uintptr_t at)
{
    return *(volatile uint32_t *)at;
}

static inline void virt_put(uintptr_t at, uint32_t value)
{
    *(volatile uint32_t *)at = value;
}

uint32_t virt_cpu(void);
void virt_say(const char *text); /* on the console of the debugger (semihosting) */
void virt_interrupts(uint32_t number, void (*handler)(void)); /* take an interrupt of a device, and that of the timer */
void virt_interrupt(void); /* of start.S, as virt_fault */
void virt_fault(uint32_t kind, uint32_t at);

#endif
