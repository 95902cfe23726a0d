/* The port of a board: what its processor gives to the program (port_...), its CAN driver (can_...), and what the program does for
 * both. docs/firmware.md of canskin, "A port", says what each has to keep.
 */
#ifndef PORT_H
#define PORT_H

#include "skin_node.h"
#include "skin_slots.h"

/* Frames that wait between the interrupts and the main loop: a whole block of a program download, and what else comes meanwhile. */
#ifndef PORT_RECEIVED
#define PORT_RECEIVED (SKIN_BLOCK_SEGMENTS + 16u)
#endif
/* Answers to one SYNC, an answer to SDO, a heartbeat, emergencies. */
#ifndef PORT_SENT
#define PORT_SENT (SKIN_TPDOS + 8u)
#endif

/* The processor. */

void port_open(void); /* clock, converters, timer, and the CAN controller by can_open; then interrupts may come */
int64_t port_now_ns(void); /* a time that never falls and never wraps */
uint32_t port_lock(void); /* no interrupts; returns what port_unlock takes */
void port_unlock(uint32_t before);
void port_idle(int (*has_work)(void)); /* sleep until the next interrupt, unless has_work() tells 1; an interrupt comes each millisecond */
void port_alive(void); /* the watchdog: the main loop has come round */
void port_reset(void); /* as at power-up; does not return */

/* Switches: bus and node-ID (0: LSS gives the node-ID), and the serial number, 0 for that of board.c. */
uint8_t port_bus(void);
uint8_t port_node_id(void);
uint32_t port_serial_number(void);

/* In the interrupt of a SYNC: the samples of the SKIN_READINGS converters since the one before, at most SKIN_SAMPLES, the last of this
 * SYNC; returns their number. Stepped boards: one sample each millisecond, with NULL.
 */
uint16_t port_convert(const skin_frame *sync, skin_reading *readings);

/* Flash memory for programs, and for the records of skin_storage.h; the slot of the program that the bootloader has started. */
extern const skin_flash port_programs, port_records;
uint8_t port_slot(void);
void port_start(uint8_t slot); /* of the bootloader: start the program of a slot; does not return */

/* Of flash_cfi.c: the first sector of this board. While the board has taken the memory, nobody else uses it; nothing to do if the board
 * has it for itself.
 */
#define FLASH_SECTOR_BYTES 0x40000u
uintptr_t flash_base(void);
void flash_take(void);
void flash_give(void);

/* The CAN driver: one transmit buffer. */

void can_open(uintptr_t base, uint32_t clock_hz); /* reset the controller, with the bit rates of board.h */
void can_interrupt(void); /* calls port_received and port_transmitted */
void can_transmit(const skin_frame *frame); /* the buffer is free; interrupts are off */
void can_abort(void); /* take back what has not begun; port_transmitted tells what became of the frame */

/* What the driver calls in its interrupt. */

void port_received(skin_frame *frame); /* a data frame with 11 bits of identifier: can_id, length, flags, data */
void port_transmitted(int was_sent); /* the buffer is free; 0: the frame was given up */

/* queues.c: between the interrupts and the main loop. */

typedef struct {
    uint32_t received, sent, lost, given_up; /* lost: by the queue or by the controller */
} port_counts;
extern volatile port_counts port_count;

int queue_put(const skin_frame *frame); /* interrupt; 0: no room */
int queue_take(skin_frame *frame); /* main loop; 0: none */
int queue_waits(void);
int queue_send(const skin_frame *frame); /* 0: no room */
int queue_outcome(skin_frame *frame); /* identifier of a frame that is done: SKIN_FRAME_ECHO, or SKIN_FRAME_DISCARDED; 0: none */
int queue_is_sending(void);
void queue_tick(int64_t now_ns); /* gives up what waits for longer than its window */

#endif
