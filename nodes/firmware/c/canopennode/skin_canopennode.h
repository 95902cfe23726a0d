/* A board behind CANopenNode V4: where the stack's calls go, and where the application calls.
 *
 * Compile with OD.c and board.c, the sources of src/ and, of stepped boards, src/steps/. None of the functions
 * may interrupt another.
 */
#ifndef SKIN_CANOPENNODE_H
#define SKIN_CANOPENNODE_H

#include <stdint.h>

#include "board.h"
#include "skin_average.h"
#include "skin_sums.h"

/* Of an image for several boards: write what is this board's own into the dictionary, first of all, before CO_CANopenInit and
 * before stored values are read. `bus` is the number of the bus in the layout. Returns 0 on success, 1 if the image has no such
 * board.
 */
int skin_app_choose(uint8_t bus, uint8_t node_id);

#if !SKIN_STEPPED

/*   after CO_CANopenInitPDO      skin_app_init()
 *   in the SYNC interrupt        read all converters, and keep counter = co->SYNC->counter (CO_SYNC_initCallbackPre tells that the
 *                                SYNC has come); both stay as they are until skin_app_sync has returned
 *   in the real-time task        if (CO_process_SYNC(...) says that a SYNC was, with all converters read)
 *                                    skin_app_sync(readings, samples, counter);    before CO_process_TPDO(...)
 *   in the CAN driver            skin_app_dropped() in CO_CANclearPendingSyncPDOs, for every frame that is given up
 *
 * Boards that send in turns (18xxh:2 above 1), between skin_app_sync and CO_process_TPDO, since the stack counts the SYNCs that it
 * gets, and a lost one would exchange the turns for good:
 *       for (each = 0; each < OD_CNT_TPDO; each++) {
 *           CO_TPDO_t *tpdo = &co->TPDO[each];
 *           tpdo->syncCounter = skin_is_turn(tpdo->transmissionType, tpdo->syncStartValue, counter) ? 1 : 2;
 *       }
 *
 * Sums of other widths than 8 and 16 bits need CO_CONFIG_PDO_BITWISE_MAPPING.
 */

/* Connect the objects of the skin with the dictionary; end test patterns; begin to count anew. Returns 0 on success. */
int skin_app_init(void);

/* Make the sums that the next TPDOs carry, behind `counter` (2022h), that of the SYNC of the last sample.
 *
 * readings: what the converters read since the last SYNC, `samples` samples of `skin_readings` values, the last at this SYNC.
 * Boards with SKIN_SAMPLES of 1 use the last sample, others the average. The readings are overwritten.
 */
void skin_app_sync(skin_reading *readings, uint16_t samples, uint8_t counter);

/* Count a TPDO that could not be sent within the window (1007h); the application reports EMCY FF10h,
 * and EMCY 0000h after SKIN_WINDOWS_MET SYNCs without one.
 */
void skin_app_dropped(void);

#else

/*   at power-up, with the dictionary as it was stored     skin_app_init(), then skin_app_sample(counts) every millisecond
 *                                until it returns 1: 2.3 s, in which nothing may touch the patch
 *   after CO_CANopenInitPDO, also after resets            skin_app_reset()
 *   in the real-time task, every millisecond, with all taxels read
 *       skin_app_sample(counts);
 *       sync_was = CO_process_SYNC(co, 1000, NULL);
 *       for (each = held = 0; each < OD_CNT_TPDO; each++) {
 *           held |= co->TPDO[each].CANtxBuff->bufferFull << each;
 *       }
 *       requests = skin_app_requests(co->NMT->operatingState == CO_NMT_OPERATIONAL, sync_was ? co->SYNC->counter : 0, 1000000,
 *                                    held);
 *       for (each = 0; each < OD_CNT_TPDO; each++) {
 *           co->TPDO[each].sendRequest = (requests >> each & 1) != 0;      the stack would send all of them at the start
 *       }
 *       CO_process_TPDO(co, sync_was, 1000, NULL);
 *   in the CAN driver, where there is a place for that    skin_app_dropped(tpdo) for every frame that CO_CANclearPendingSyncPDOs
 *                                or a bus-off takes away; otherwise the gateway notes the loss by the counts of the words
 *
 * In slots (transmission type 254) as at SYNC (type 0 or 1) the stack's own driver will do. It holds no more than one frame of
 * each TPDO. Stock CANopenNode has no CAN FD.
 */

/* Connect the objects of the skin with the dictionary; nothing is known of the noise. Returns 0 on success. */
int skin_app_init(void);

/* Forget all frames; end test patterns; begin to count anew; take the settings from the dictionary. */
void skin_app_reset(void);

/* Take one sample of all taxels in the order of 2004h, ADC counts, which are overwritten.
 *
 * Returns 0 while the board learns its noise.
 */
int skin_app_sample(uint16_t *counts);

/* Decide what to send with the newest sample, if a slot has begun, and put its number and words into 2022h and 2110h.
 *
 * is_operational: the NMT state. counter: of a SYNC that came since the last call, else 0. passed_ns: time since the last call.
 * held: the TPDOs whose frames wait for the bus, the first in bit 0: they leave the slot out. Returns the TPDOs to be sent.
 */
uint8_t skin_app_requests(int is_operational, uint8_t counter, int64_t passed_ns, uint8_t held);

/* Take note of a frame that was requested and not sent. */
void skin_app_dropped(uint8_t tpdo);

#endif

#endif
