/* fluxobs, storage: writes the parameters of an observer, and what it has learnt, as bytes with a
 * checksum, for flash or EEPROM. The bytes are the same on every processor (least significant
 * first).
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_KEEP_H
#define FLUXOBS_KEEP_H

#include "fluxobs_observers.h"

#ifdef __cplusplus
extern "C" {
#endif

#define fo_pack FO_NAME(fo_pack)
#define fo_unpack FO_NAME(fo_unpack)
#if FO_ASYMMETRIC
#define fo_adaptive_pack FO_NAME(fo_adaptive_pack_asymmetric)
#define fo_adaptive_unpack FO_NAME(fo_adaptive_unpack_asymmetric)
#define fo_adaptive_save FO_NAME(fo_adaptive_save_asymmetric)
#define fo_adaptive_restore FO_NAME(fo_adaptive_restore_asymmetric)
#else
#define fo_adaptive_pack FO_NAME(fo_adaptive_pack)
#define fo_adaptive_unpack FO_NAME(fo_adaptive_unpack)
#define fo_adaptive_save FO_NAME(fo_adaptive_save)
#define fo_adaptive_restore FO_NAME(fo_adaptive_restore)
#endif

/* Version of the blobs. The version changes when a field is added to an observer or to its
 * state. */
#define FO_LAYOUT 3U

/* Bytes of a blob with this many numbers: head, numbers, checksum. */
#define FO_HEAD 12U
#define FO_CHECKSUM 4U
#define FO_BYTES(numbers) (FO_HEAD + (uint32_t)(numbers) * (uint32_t)sizeof(fo_real) + FO_CHECKSUM)

/* Numbers of an observer without its map. The adaptive observer has more numbers, see below. */
#define FO_COUNT_MATRIX(name, meaning) +FO_N * FO_N
#define FO_COUNT_ARRAY(name, size, meaning) +(size)
#define FO_COUNT_NUMBER(name, meaning) +1
enum { FO_NUMBERS = 0 FO_OBSERVER_FIELDS(FO_COUNT_MATRIX, FO_COUNT_ARRAY, FO_COUNT_NUMBER) };
#define FO_PACKED_BYTES FO_BYTES(FO_NUMBERS)

/* Writes the parameters: FO_PACKED_BYTES bytes. A PC or another drive can make such a blob by
 * fo_init, for a motor that is chosen in the field. The blob does not include a flux map: call
 * fo_use_map after unpacking. */
void fo_pack(const fo_observer *observer, uint8_t blob[FO_PACKED_BYTES]);

/* Reads the parameters. FO_ERROR_DAMAGED: length, version or checksum is wrong. FO_ERROR_OTHER: the
 * blob has another precision or kind of observer, or needs a feature that these sources leave out
 * (fluxobs_real.h). On an error the observer does not change. */
fo_error fo_unpack(fo_observer *observer, const uint8_t *blob, uint32_t length);

#if FO_ADAPTIVE
enum {
    FO_ADAPTIVE_NUMBERS = FO_NUMBERS FO_ADAPTIVE_FIELDS(FO_COUNT_ARRAY, FO_COUNT_NUMBER) + 1,
    /* the parameters' part of the factor, with weights, right-hand sides and estimates; the
     * parameters' prior means; a checksum of the units */
    FO_SAVED_NUMBERS = FO_NP * (FO_NP - 1) / 2 + 3 * FO_NP + 3 + 1
};
#define FO_ADAPTIVE_PACKED_BYTES FO_BYTES(FO_ADAPTIVE_NUMBERS)
#define FO_SAVED_BYTES FO_BYTES(FO_SAVED_NUMBERS)

void fo_adaptive_pack(const fo_adaptive *observer, uint8_t blob[FO_ADAPTIVE_PACKED_BYTES]);
fo_error fo_adaptive_unpack(fo_adaptive *observer, const uint8_t *blob, uint32_t length);

/* Writes what has been learnt: magnet flux, resistance, inverter loss, offsets, inductances,
 * asymmetry, and their covariance. Writes FO_SAVED_BYTES bytes. `observer` is the observer in use
 * now. */
void fo_adaptive_save(const fo_adaptive *observer, const fo_adaptive_state *state,
                      uint8_t blob[FO_SAVED_BYTES]);

/* Resets the state, and restores what an observer with the same bases and standard deviations has
 * saved. The prior means may differ. `changed` is the std of the resistance's change since then, as
 * a share of the resistance. Copper changes by 0.4 % a kelvin; use 0.2 for a motor that was warm.
 * On FO_ERROR_DAMAGED and FO_ERROR_OTHER the state is reset, with the parameters at their prior. */
fo_error fo_adaptive_restore(const fo_adaptive *observer, fo_adaptive_state *state,
                             const uint8_t *blob, uint32_t length, fo_real changed);
#endif

#ifdef __cplusplus
}
#endif

#endif
