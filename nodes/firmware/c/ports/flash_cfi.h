/* What a port tells flash_cfi.c. */
#ifndef FLASH_CFI_H
#define FLASH_CFI_H

#include <stdint.h>

#define FLASH_SECTOR_BYTES 0x40000u

uintptr_t flash_base(void); /* address of the first sector of this board */
/* The memory is this board's alone from take to give: it cannot be read meanwhile. Nothing to do if the board has it for itself. */
void flash_take(void);
void flash_give(void);

#endif
