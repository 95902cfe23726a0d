/* The sums of a board behind CANopenNode V4: where the stack's calls go, and where the application calls.
 *
 *   after CO_CANopenInitPDO      skin_app_init()
 *   in the SYNC interrupt        sample all taxels (CO_SYNC_initCallbackPre tells that the SYNC has come)
 *   in the real-time task        if (CO_process_SYNC(...) says that a SYNC was, with all taxels read)
 *                                    skin_app_sync(counts, samples);      before CO_process_TPDO(...)
 *   in the CAN driver            skin_app_dropped() in CO_CANclearPendingSyncPDOs, for every frame that is given up
 *
 * Sums of 12 bits need CO_CONFIG_PDO_BITWISE_MAPPING. Compile with OD.c and board.c of the board,
 * skin_sums.c and skin_average.c.
 */
#ifndef SKIN_CANOPENNODE_H
#define SKIN_CANOPENNODE_H

#include <stdint.h>

/* Connect the objects of the skin with the dictionary; end test patterns; begin to count anew. Returns 0 on success. */
int skin_app_init(void);

/* Make the sums that the next TPDOs carry.
 *
 * counts: what all taxels read since the last SYNC in the order of the chains (2004h), ADC counts; `samples` samples, the
 * last at this SYNC. Boards with SKIN_SAMPLES of 1 use the last sample, others the average. The counts are overwritten.
 */
void skin_app_sync(uint16_t *counts, uint16_t samples);

/* Count a TPDO that could not be sent within the window (1007h); the application reports EMCY FF10h. */
void skin_app_dropped(void);

#endif
