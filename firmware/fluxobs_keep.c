/* SPDX-License-Identifier: MIT */
#include "fluxobs_keep.h"

#include "fluxobs_internal.h"
#if FO_ADAPTIVE
#include "fluxobs_learning.h"
#endif

#include <string.h>

/* Content of a blob. */
#define CONTENT_PLAIN 1U
#define CONTENT_ADAPTIVE 2U
#define CONTENT_SAVED 3U

/* A number and its bits. */
#if FO_SINGLE
typedef uint32_t bit_pattern;
#else
typedef uint64_t bit_pattern;
#endif
typedef union {
    fo_real value;
    bit_pattern bits;
} float_bits;

/* A blob stores all bits of a number. If double has 32 bits, FO_SINGLE must be 1. */
typedef char fo_numbers_fill_their_bits[sizeof(fo_real) == sizeof(bit_pattern) ? 1 : -1];

/* ---- bytes ------------------------------------------------------------------------------ */

static void put_bytes(uint8_t *at, uint32_t value, uint32_t bytes)
{
    for (uint32_t n = 0U; n < bytes; n++) {
        at[n] = (uint8_t)((value >> (8U * n)) & 0xFFU);
    }
}

static uint32_t get_bytes(const uint8_t *at, uint32_t bytes)
{
    uint32_t value = 0U;
    for (uint32_t n = 0U; n < bytes; n++) {
        value |= (uint32_t)at[n] << (8U * n);
    }
    return value;
}

/* CRC-32 of IEEE 802.3, bit by bit. The code is short; speed does not matter here. */
static uint32_t checksum(const uint8_t *bytes, uint32_t length)
{
    uint32_t sum = 0xFFFFFFFFU;
    for (uint32_t n = 0U; n < length; n++) {
        sum ^= (uint32_t)bytes[n];
        for (int bit = 0; bit < 8; bit++) {
            sum = (sum & 1U) != 0U ? (sum >> 1U) ^ 0xEDB88320U : sum >> 1U;
        }
    }
    return sum ^ 0xFFFFFFFFU;
}

static void put_number(uint8_t *at, fo_real value)
{
    float_bits number;
    number.value = value;
    for (uint32_t n = 0U; n < (uint32_t)sizeof number; n++) {
        at[n] = (uint8_t)((number.bits >> (8U * n)) & (bit_pattern)0xFFU);
    }
}

static fo_real get_number(const uint8_t *at)
{
    float_bits number;
    number.bits = 0U;
    for (uint32_t n = 0U; n < (uint32_t)sizeof number; n++) {
        const uint32_t shift = 8U * n;
        const bit_pattern byte = at[n];
        number.bits |= byte << shift;
    }
    return number.value;
}

/* Position in a blob that is either written or read; the other pointer is null. */
typedef struct {
    uint8_t *write;
    const uint8_t *read;
} cursor;

static void transfer(cursor *c, fo_real *number)
{
    if (c->write != NULL) {
        put_number(c->write, *number);
        c->write = &c->write[sizeof *number];
    } else {
        *number = get_number(c->read);
        c->read = &c->read[sizeof *number];
    }
}

static void transfer_all(cursor *c, fo_real numbers[], int count)
{
    for (int n = 0; n < count; n++) {
        transfer(c, &numbers[n]);
    }
}

/* Features that an observer needs from the sources that run it. */
#define FEATURE_ASYMMETRY 1U
#define FEATURE_HELD 2U
#define FEATURE_MAP 4U

static uint32_t features_of(const fo_observer *o)
{
    uint32_t result = 0U;
    if (fo_abs(o->kink_now) > ZERO) {
        result |= FEATURE_HELD;
    }
    if (has_map(o)) {
        result |= FEATURE_MAP;
    }
    return result;
}

/* Do these sources leave out any of these features? */
static bool lacks_feature(uint32_t features)
{
    bool result = false;
    (void)features;
#if !FO_HELD
    result = result || (features & FEATURE_HELD) != 0U;
#endif
#if !FO_MAPPED
    result = result || (features & FEATURE_MAP) != 0U;
#endif
    return result;
}

/* Head of a blob: "FO", version, content, bytes of a number, features, length. */
static void put_head(uint8_t *blob, uint32_t of, uint32_t features, uint32_t length)
{
    put_bytes(&blob[0], 0x4F46U, 2U);
    put_bytes(&blob[2], FO_LAYOUT, 2U);
    put_bytes(&blob[4], of, 1U);
    put_bytes(&blob[5], (uint32_t)sizeof(fo_real), 1U);
    put_bytes(&blob[6], features, 2U);
    put_bytes(&blob[8], length, 4U);
}

static void close_blob(uint8_t *blob, uint32_t length)
{
    put_bytes(&blob[length - FO_CHECKSUM], checksum(blob, length - FO_CHECKSUM), 4U);
}

static fo_error check_blob(const uint8_t *blob, uint32_t length, uint32_t of, uint32_t wanted)
{
    const uint32_t least = FO_HEAD + FO_CHECKSUM;
    const uint32_t whole = length < least ? 0U : get_bytes(&blob[8], 4U);
    fo_error result = FO_OK;
    if (whole < least || whole > length || get_bytes(&blob[0], 2U) != 0x4F46U ||
        get_bytes(&blob[whole - FO_CHECKSUM], 4U) != checksum(blob, whole - FO_CHECKSUM)) {
        result = FO_ERROR_DAMAGED;
    } else {
        uint8_t head[FO_HEAD];
        const uint32_t features = get_bytes(&blob[6], 2U);
        const bool asymmetric = (features & FEATURE_ASYMMETRY) != 0U;
        put_head(head, of, features, wanted);
        if (memcmp(head, blob, sizeof head) != 0 || lacks_feature(features) ||
            asymmetric != (FO_ASYMMETRIC == 1 && of != CONTENT_PLAIN)) {
            result = FO_ERROR_OTHER;
        }
    }
    return result;
}

/* ---- parameters ------------------------------------------------------------------------- */

#define TRANSFER_MATRIX(name, meaning)               \
    for (int row = 0; row < FO_N; row++) {       \
        transfer_all(c, o->name[row], FO_N);         \
    }
#define TRANSFER_ARRAY(name, size, meaning) transfer_all(c, o->name, (size));
#define TRANSFER_NUMBER(name, meaning) transfer(c, &o->name);

static void transfer_observer(cursor *c, fo_observer *o)
{
    FO_OBSERVER_FIELDS(TRANSFER_MATRIX, TRANSFER_ARRAY, TRANSFER_NUMBER)
}

void fo_pack(const fo_observer *o, uint8_t blob[FO_PACKED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    fo_observer copy;
    copy = *o;
    put_head(blob, CONTENT_PLAIN, features_of(o), FO_PACKED_BYTES);
    transfer_observer(&c, &copy);
    close_blob(blob, FO_PACKED_BYTES);
}

fo_error fo_unpack(fo_observer *o, const uint8_t *blob, uint32_t length)
{
    const fo_error result = check_blob(blob, length, CONTENT_PLAIN, FO_PACKED_BYTES);
    if (result == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        transfer_observer(&c, o);
#if FO_MAPPED
        o->map = NULL;
#endif
    }
    return result;
}

#if FO_ADAPTIVE
static void transfer_adaptive(cursor *c, fo_adaptive *o)
{
    fo_real projection = o->projection == FO_PROJECT_START ? ONE : ZERO;
    transfer_observer(c, &o->plain);
    FO_ADAPTIVE_FIELDS(TRANSFER_ARRAY, TRANSFER_NUMBER)
    transfer(c, &projection);
    o->projection = projection > ZERO ? FO_PROJECT_START : FO_PROJECT_NEVER;
}

void fo_adaptive_pack(const fo_adaptive *a, uint8_t blob[FO_ADAPTIVE_PACKED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    fo_adaptive copy;
    copy = *a;
    put_head(blob, CONTENT_ADAPTIVE, features_of(&a->plain) | (uint32_t)FO_ASYMMETRIC,
             FO_ADAPTIVE_PACKED_BYTES);
    transfer_adaptive(&c, &copy);
    close_blob(blob, FO_ADAPTIVE_PACKED_BYTES);
}

fo_error fo_adaptive_unpack(fo_adaptive *a, const uint8_t *blob, uint32_t length)
{
    const fo_error result = check_blob(blob, length, CONTENT_ADAPTIVE, FO_ADAPTIVE_PACKED_BYTES);
    if (result == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        transfer_adaptive(&c, a);
#if FO_MAPPED
        a->plain.map = NULL;
#endif
    }
    return result;
}

/* ---- what has been learnt --------------------------------------------------------------- */

/* Checksum of the units of the learnt parameters, as a number. Observers with other units have
 * another checksum. */
static fo_real unit_checksum(const fo_adaptive *a)
{
    uint8_t bytes[((uint32_t)FO_NP + 3U) * (uint32_t)sizeof(fo_real)];
    cursor c = {bytes, NULL};
    fo_real units[3] = {a->plain.flux_base, a->plain.drift_base, a->plain.sample_time};
    fo_real stds[FO_NP];
    (void)memcpy(stds, a->std, sizeof stds);
    transfer_all(&c, units, 3);
    transfer_all(&c, stds, (int)FO_NP);
    const uint32_t sum = checksum(bytes, (uint32_t)sizeof bytes) >> 8U;
    return (fo_real)sum; /* a sum of 24 bits is exact */
}

/* The parameters' part of the information factor, their estimates, and their prior means. */
typedef struct {
    fo_real p[FO_NP], d[FO_NP], z[FO_NP], U[FO_NP * (FO_NP - 1) / 2], means[FO_PRIOR_MEANS];
} learnt_numbers;

static void transfer_learnt(cursor *c, learnt_numbers *of)
{
    transfer_all(c, of->p, (int)FO_NP);
    transfer_all(c, of->d, (int)FO_NP);
    transfer_all(c, of->z, (int)FO_NP);
    transfer_all(c, of->U, (int)FO_NP * ((int)FO_NP - 1) / 2);
    transfer_all(c, of->means, (int)FO_PRIOR_MEANS);
}

/* Are all numbers finite, and the weights positive? */
static bool are_plausible(const learnt_numbers *of)
{
    fo_real sum = ZERO;
    bool positive = true;
    for (int i = 0; i < (int)FO_NP; i++) {
        sum += of->p[i] + of->z[i] + of->d[i];
        positive = positive && of->d[i] > ZERO;
    }
    for (int i = 0; i < (int)FO_NP * ((int)FO_NP - 1) / 2; i++) {
        sum += of->U[i];
    }
    for (int i = 0; i < (int)FO_PRIOR_MEANS; i++) {
        sum += of->means[i];
    }
    return positive && sum - sum == ZERO;
}

void fo_adaptive_save(const fo_adaptive *a, const fo_adaptive_state *s,
                      uint8_t blob[FO_SAVED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    learnt_numbers learnt;
    fo_real units_checksum = unit_checksum(a);
    (void)memset(&learnt, 0, sizeof learnt);
    (void)memcpy(learnt.p, s->learner.p, sizeof learnt.p);
    (void)memcpy(learnt.d, &s->learner.d[FO_NF], sizeof learnt.d);
    (void)memcpy(learnt.z, &s->learner.z[FO_NF], sizeof learnt.z);
    (void)memcpy(learnt.U, &s->learner.U[FO_ROW(FO_NA, FO_NF)], sizeof learnt.U);
    for (int i = 0; i < (int)FO_NP && is_never_reset(&s->plain); i++) { /* a state of zeros stands
                                                                         * for the prior */
        learnt.d[i] = ONE;
    }
    (void)memcpy(learnt.means, s->learner.means, sizeof learnt.means);
    if (is_never_reset(&s->plain)) {
        fo_learning_prior_means(a, learnt.means);
    }
    put_head(blob, CONTENT_SAVED, (uint32_t)FO_ASYMMETRIC, FO_SAVED_BYTES);
    transfer(&c, &units_checksum);
    transfer_learnt(&c, &learnt);
    close_blob(blob, FO_SAVED_BYTES);
}

fo_error fo_adaptive_restore(const fo_adaptive *a, fo_adaptive_state *s, const uint8_t *blob,
                             uint32_t length, fo_real changed)
{
    fo_error result = check_blob(blob, length, CONTENT_SAVED, FO_SAVED_BYTES);
    fo_adaptive_reset(a, s);
    if (result == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        const fo_real std = a->std[FO_RESISTANCE], expected = unit_checksum(a);
        fo_real units_checksum = ZERO;
        learnt_numbers learnt;
        transfer(&c, &units_checksum);
        transfer_learnt(&c, &learnt);
        if (!are_plausible(&learnt)) {
            result = FO_ERROR_DAMAGED;
        } else if (units_checksum < expected || units_checksum > expected) {
            result = FO_ERROR_OTHER;
        } else {
            fo_learner *r = &s->learner;
            fo_real unused[2 * FO_N] = {0};
            (void)memcpy(r->p, learnt.p, sizeof learnt.p);
            (void)memcpy(&r->d[FO_NF], learnt.d, sizeof learnt.d);
            (void)memcpy(&r->z[FO_NF], learnt.z, sizeof learnt.z);
            (void)memcpy(&r->U[FO_ROW(FO_NA, FO_NF)], learnt.U, sizeof learnt.U);
            (void)memcpy(r->means, learnt.means, sizeof learnt.means);
            fo_learning_move_prior_means(a, r, unused, &unused[FO_N]);
            fo_learning_widen_resistance(a, r,
                                         std > ZERO ? changed * learnt.means[1] / std : ZERO);
            fo_learning_values(a, r, s->value);
            s->report = r->report;
        }
    }
    return result;
}
#endif
