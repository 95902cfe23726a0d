/* A small CANopen slave (CiA 301) that sends the sums of one board; no heap, no operating system.
 *
 * NMT, heartbeat producer and consumer, SYNC, TPDOs of the transmission types 0 to 240, 254 and 255, or of steps,
 * EMCY, one SDO server with expedited and segmented transfers, program download in blocks, and the objects of a skin node.
 * Every function returns at once, but for what the driver's flash memory takes.
 */
#ifndef SKIN_NODE_H
#define SKIN_NODE_H

#include <stddef.h>

#include "board.h"
#include "skin_average.h"
#include "skin_bytes.h"
#include "skin_program.h"
#include "skin_storage.h"
#include "skin_sums.h"
#if SKIN_STEPPED
#include "skin_steps.h"
#endif

/* Payload that a frame has room for; 8 is enough for a program of boards on classic CAN. */
#ifndef SKIN_FRAME_BYTES
#define SKIN_FRAME_BYTES 64
#endif

/* Segments of a block of a program download, at most 127: a board takes fewer if its receive queue or its flash memory asks for that. */
#ifndef SKIN_BLOCK_SEGMENTS
#define SKIN_BLOCK_SEGMENTS 127u
#endif

/* One frame, in the records of dbc/frame.py. */
typedef struct {
    int64_t time_ns;    /* of a received frame: its end; of a frame to send: earliest start, 0 for now */
    int64_t expires_ns; /* of a frame to send: latest start, 0 for no limit */
    uint32_t can_id;
    uint8_t length; /* payload in bytes */
    uint8_t flags;  /* SKIN_FRAME_... */
    uint16_t port;  /* node-ID of the board that sends */
    uint8_t data[SKIN_FRAME_BYTES];
} skin_frame;

/* A frame that the controller has given up: its window ended, or it is bus-off. */
#define SKIN_FRAME_DISCARDED (SKIN_FRAME_ECHO | SKIN_FRAME_ERROR)

/* Frames that wait to be sent; frames beyond `capacity` are lost. */
typedef struct {
    skin_frame *frames;
    size_t capacity, count;
} skin_outbox;

/* Errors that are reported: heartbeat of a watched node lost, SYNC of a wrong length, window missed. */
enum { SKIN_ERROR_HEARTBEAT, SKIN_ERROR_SYNC_LENGTH, SKIN_ERROR_WINDOW, SKIN_ERRORS };

#if !SKIN_STEPPED
typedef struct {
    uint16_t cob_id;
    uint8_t type, start; /* transmission type, SYNC start value */
    uint8_t length;      /* payload in bytes; 0: the PDO does not exist */
    uint8_t mapped;      /* mapped objects */
    uint8_t has_last;    /* whether `last` was sent */
    uint8_t last[SKIN_PDO_BYTES];
    uint16_t objects[SKIN_MAPPED]; /* places in board->type->objects */
    uint32_t syncs;                /* SYNCs while the PDO existed */
    uint32_t sent_at_ms, inhibit_ms, event_ms;
} skin_tpdo;
#endif

typedef struct {
    uint8_t node_id; /* 0: unused entry */
    uint8_t state;   /* 0: not heard yet, 1: alive, 2: lost */
    uint16_t time_ms;
    uint32_t due_ms;
} skin_watch;

typedef struct {
    uint16_t index;
    uint8_t subindex;
    uint8_t mode; /* 0: no transfer; upload, download, blocks of a download, end of these */
    uint8_t toggle;
    uint16_t done;  /* bytes transferred */
    uint16_t bytes; /* of an upload */
    const uint8_t *source;
    uint8_t data[8]; /* of a download; no object that can be written is longer */
    uint8_t number;  /* of the newest segment of a block that came in its order */
    uint8_t has_crc; /* the client sends a CRC */
    uint16_t crc;    /* of the blocks */
    uint32_t due_ms; /* the client has given up a block download */
} skin_sdo;

/* LSS (CiA 305). What follows `is_configured` is between the slave and the driver. */
typedef struct {
    uint8_t node_id; /* in use, SKIN_NO_NODE_ID for none */
    uint8_t lasting; /* at power-up, unless the storage has another */
    uint8_t wanted;  /* from the next initialisation on */
    uint8_t matched, in_range, scanned; /* numbers of the address that the master has named right */
    uint8_t is_configured; /* state LSS configuration: the LED flickers (CiA 303-3) */
    uint16_t bit_timings;  /* bit n: the driver knows bit timing n; after skin_init SKIN_BIT_TIMINGS */
    uint8_t bit_timing;    /* index of the bit timing that was given or stored, SKIN_NO_BIT_TIMING for none */
    uint8_t is_switching;  /* the driver is to be silent for the delay, to switch, to be silent once more, and to clear this */
    uint16_t switch_delay_ms;
} skin_lss;

typedef struct {
    const skin_board *board;
    skin_outbox *outbox;
    const skin_storage *storage; /* NULL: 1010h is refused */
    uint8_t state;
    uint8_t changed; /* an object below 2000h was written */
    uint8_t has_stored;
    uint8_t values[SKIN_WRITABLE_BYTES]; /* of objects that SDO can write */
    uint8_t stored[SKIN_WRITABLE_BYTES]; /* what 1010h has stored */
    float gain[SKIN_BLOCKS][SKIN_CALIBRATED];
    int16_t offset[SKIN_BLOCKS][SKIN_CALIBRATED];
    uint8_t pattern[SKIN_BLOCKS];
    uint16_t counts[SKIN_BLOCKS][SKIN_CALIBRATED]; /* 2012h: the newest sample, corrected */
#if SKIN_STEPPED
    skin_steps steps;
#else
#if SKIN_SAMPLES > 1
    skin_average averages[SKIN_BLOCKS];
#endif
    int32_t sums[SKIN_SUMS]; /* at the newest SYNC, ADC counts */
    uint8_t sync_counter;    /* 2022h: of this SYNC; 0 if it had none */
    skin_tpdo tpdos[SKIN_TPDOS];
#endif
    uint32_t health[4];      /* 2020h: SYNCs received, TPDOs sent, TPDOs dropped, saturated taxels */
    skin_sdo sdo;
    skin_lss lss;
    skin_program program;
    skin_watch watched[SKIN_WATCHED];
    uint32_t heartbeat_ms, heartbeat_due_ms;
    uint8_t active[SKIN_ERRORS];
    uint32_t missed_at; /* health[0] at the newest missed window */
    uint32_t history[SKIN_ERRORS_KEPT]; /* 1003h, newest first */
    uint8_t history_count;
    uint8_t waiting[SKIN_ERRORS_KEPT][8]; /* emergencies, oldest first */
    uint8_t waiting_count;
    uint32_t emcy_free_ms;
    uint32_t serial_number; /* 1018h:4, for the driver to set after skin_init; 0: that of board.c for this node-ID */
} skin_node;

/* Connect a node to its board, its outbox and its storage, and read what 1010h has stored; to be called once, before
 * everything else.
 */
void skin_init(skin_node *node, const skin_board *board, skin_outbox *outbox, const skin_storage *storage);

/* Connect the memory of programs, which must outlive the node, and the slot that runs; after skin_init, or not at all. */
void skin_program_init(skin_node *node, const skin_flash *flash, uint8_t slot);

/* Boot: restore parameters, send the boot-up message, enter PRE-OPERATIONAL. Times are milliseconds that may wrap. */
void skin_boot(skin_node *node, uint32_t now_ms, int communication_only);

/* In place of skin_boot, for a board without switches for its node-ID: boot with the node-ID that LSS has stored, else be silent
 * until LSS gives one.
 */
void skin_lss_boot(skin_node *node, uint32_t now_ms);

/* Boot with the newest node-ID: that which is stored, or after a reset of the communication alone that which LSS gave last. */
void skin_lss_reset(skin_node *node, uint32_t now_ms, int communication_only);

/* Do what is due by time: heartbeats, emergencies, event-driven PDOs. To be called every few milliseconds. */
void skin_tick(skin_node *node, uint32_t now_ms);

#if SKIN_STEPPED

/* Take one sample of all taxels in the order of the chain, ADC counts, which are overwritten: every millisecond.
 *
 * Returns 0 while the board learns its noise after `skin_init`: 2.3 s, in which nothing may touch it. `skin_boot` comes
 * after that.
 */
int skin_sample(skin_node *node, uint16_t *counts);

/* Send what is worth its bits in the newest sample, if a slot of the board has begun. A frame stays in the transmit buffer until
 * it has gone; the board makes no other one of the same identifier meanwhile.
 */
void skin_send_sums(skin_node *node, int64_t now_ns);

/* Take note of a TPDO that was on the bus. */
void skin_sent(skin_node *node, const skin_frame *frame);

/* Heed a SYNC: slots are counted from its end (`time_ns`). */
void skin_sync(skin_node *node, const skin_frame *sync);

#else

/* Answer a SYNC with the sums of what the converters have read since the SYNC before: `samples` samples of `skin_readings`
 * values each, the last at this SYNC. Boards with SKIN_SAMPLES of 1 use the last sample, others the average. The readings are
 * overwritten.
 */
void skin_sync(skin_node *node, const skin_frame *sync, skin_reading *readings, uint16_t samples);

#endif

/* Obey an NMT command; heed a heartbeat; answer an SDO request; count a frame that was given up, and one that a full transmit
 * queue has refused.
 */
void skin_nmt(skin_node *node, const skin_frame *command, uint32_t now_ms);
void skin_heard(skin_node *node, uint8_t node_id, uint32_t now_ms);
void skin_request(skin_node *node, const skin_frame *request, uint32_t now_ms);
void skin_given_up(skin_node *node, const skin_frame *frame);
void skin_refused(skin_node *node, const skin_frame *frame);

/* Answer a request of LSS (SKIN_LSS_REQUEST_COB_ID); the board may boot with a new node-ID. */
void skin_lss_request(skin_node *node, const skin_frame *request, uint32_t now_ms);

/* Between the parts of the node. Each calls those above it alone; skin_node.c, below all, calls them by turns. */

/* skin_objects.c */
const skin_object *skin_find(const skin_board *board, uint16_t index, uint8_t subindex);
const uint8_t *skin_value(const skin_node *node, const skin_object *object, uint8_t *scratch);
uint32_t skin_unsigned(const skin_node *node, uint16_t index, uint8_t subindex);
uint8_t skin_mapped_bits(const skin_node *node, const skin_object *object);
const skin_object *skin_mapped(const skin_node *node, uint32_t entry); /* of a mapping entry, NULL if not allowed */
uint8_t skin_watched_node(uint32_t entry); /* of an entry of 1016h, 0 for none */
uint32_t skin_missing(const skin_board *board, uint16_t index);
uint32_t skin_write(skin_node *node, uint16_t index, uint8_t subindex, const uint8_t *data, uint16_t length);
void skin_become(skin_node *node, const skin_board *board); /* with the constants of another board */
void skin_restore(skin_node *node, int communication_only);
uint8_t skin_error_register(const skin_node *node); /* 1001h: of all active errors */

/* skin_outbox.c */
skin_frame skin_new_frame(const skin_node *node, uint32_t can_id, const uint8_t *data, uint8_t length);
void skin_post(skin_node *node, const skin_frame *frame);
void skin_send(skin_node *node, uint32_t can_id, const uint8_t *data, uint8_t length);

/* skin_emergencies.c */
void skin_raise(skin_node *node, uint8_t error, uint64_t field);
void skin_settle(skin_node *node, uint8_t error);
void skin_flush_emergencies(skin_node *node, uint32_t now_ms);
int skin_take_sync(skin_node *node, const skin_frame *sync); /* its counter, 0 without; -1: it is to be ignored */

/* skin_tpdos.c or skin_stepped.c */
void skin_read_tpdo(skin_node *node, uint8_t number);
void skin_send_events(skin_node *node, uint32_t now_ms);

/* skin_sdo.c */
void skin_serve(skin_node *node, const skin_frame *request, uint32_t now_ms);
void skin_sdo_tick(skin_node *node, uint32_t now_ms);

/* skin_lss.c */
const skin_board *skin_lss_image(const skin_node *node, uint8_t node_id);
void skin_lss_load(skin_node *node); /* power-up: the stored node-ID counts */
int skin_lss_answer(skin_node *node, const skin_frame *request); /* whether the board is to boot with its first node-ID */

/* Longest value that is computed, and room for it. */
#define SKIN_NUMBER_BYTES 8

#endif
