/* SPDX-License-Identifier: MIT */
#include "fluxobs_keep.h"

#include "fluxobs_internal.h"
#if FO_ADAPTIVE
#include "fluxobs_learning.h"
#endif

#include <string.h>

/* What a blob is of. */
#define OF_PLAIN 1U
#define OF_ADAPTIVE 2U
#define OF_SAVED 3U

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

/* A blob has all bits of a number: where a double has 32, FO_SINGLE has to be 1. */
typedef char fo_numbers_fill_their_bits[sizeof(fo_real) == sizeof(bit_pattern) ? 1 : -1];

/* ---- bytes ------------------------------------------------------------------------------ */

static void put(uint8_t *at, uint32_t value, uint32_t bytes)
{
    for (uint32_t n = 0U; n < bytes; n++) {
        at[n] = (uint8_t)((value >> (8U * n)) & 0xFFU);
    }
}

static uint32_t get(const uint8_t *at, uint32_t bytes)
{
    uint32_t value = 0U;
    for (uint32_t n = 0U; n < bytes; n++) {
        value |= (uint32_t)at[n] << (8U * n);
    }
    return value;
}

/* CRC-32 of IEEE 802.3, bit by bit: it is short, and in no hurry. */
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
    float_bits one;
    one.value = value;
    for (uint32_t n = 0U; n < (uint32_t)sizeof one; n++) {
        at[n] = (uint8_t)((one.bits >> (8U * n)) & (bit_pattern)0xFFU);
    }
}

static fo_real get_number(const uint8_t *at)
{
    float_bits one;
    one.bits = 0U;
    for (uint32_t n = 0U; n < (uint32_t)sizeof one; n++) {
        const uint32_t shift = 8U * n;
        const bit_pattern byte = at[n];
        one.bits |= byte << shift;
    }
    return one.value;
}

/* A blob that is written or read, number by number. */
typedef struct {
    uint8_t *write;
    const uint8_t *read;
} cursor;

static void pass(cursor *c, fo_real *number)
{
    if (c->write != NULL) {
        put_number(c->write, *number);
        c->write = &c->write[sizeof *number];
    } else {
        *number = get_number(c->read);
        c->read = &c->read[sizeof *number];
    }
}

static void pass_all(cursor *c, fo_real numbers[], int count)
{
    for (int n = 0; n < count; n++) {
        pass(c, &numbers[n]);
    }
}

/* What an observer needs of the sources that run it. */
#define NEEDS_ASYMMETRY 1U
#define NEEDS_HELD 2U
#define NEEDS_MAP 4U

static uint32_t needs(const fo_observer *o)
{
    uint32_t found = 0U;
    if (fo_abs(o->kink_now) > ZERO) {
        found |= NEEDS_HELD;
    }
    if (mapped(o)) {
        found |= NEEDS_MAP;
    }
    return found;
}

/* Do these sources leave any of it out? */
static bool lacks(uint32_t needed)
{
    bool found = false;
    (void)needed;
#if !FO_HELD
    found = found || (needed & NEEDS_HELD) != 0U;
#endif
#if !FO_MAPPED
    found = found || (needed & NEEDS_MAP) != 0U;
#endif
    return found;
}

/* "FO", layout, content, bytes of a number, needs, then the length. */
static void put_head(uint8_t *blob, uint32_t of, uint32_t needed, uint32_t length)
{
    put(&blob[0], 0x4F46U, 2U);
    put(&blob[2], FO_LAYOUT, 2U);
    put(&blob[4], of, 1U);
    put(&blob[5], (uint32_t)sizeof(fo_real), 1U);
    put(&blob[6], needed, 2U);
    put(&blob[8], length, 4U);
}

static void close_blob(uint8_t *blob, uint32_t length)
{
    put(&blob[length - FO_CHECKSUM], checksum(blob, length - FO_CHECKSUM), 4U);
}

static fo_error examine(const uint8_t *blob, uint32_t length, uint32_t of, uint32_t wanted)
{
    const uint32_t least = FO_HEAD + FO_CHECKSUM;
    const uint32_t whole = length < least ? 0U : get(&blob[8], 4U);
    fo_error found = FO_OK;
    if (whole < least || whole > length || get(&blob[0], 2U) != 0x4F46U ||
        get(&blob[whole - FO_CHECKSUM], 4U) != checksum(blob, whole - FO_CHECKSUM)) {
        found = FO_ERROR_DAMAGED;
    } else {
        uint8_t head[FO_HEAD];
        const uint32_t needed = get(&blob[6], 2U);
        const bool asymmetric = (needed & NEEDS_ASYMMETRY) != 0U;
        put_head(head, of, needed, wanted);
        if (memcmp(head, blob, sizeof head) != 0 || lacks(needed) ||
            asymmetric != (FO_ASYMMETRIC == 1 && of != OF_PLAIN)) {
            found = FO_ERROR_OTHER;
        }
    }
    return found;
}

/* ---- parameters ------------------------------------------------------------------------- */

#define PASS_MATRIX(name, meaning)               \
    for (int row = 0; row < FO_N; row++) {       \
        pass_all(c, o->name[row], FO_N);         \
    }
#define PASS_ARRAY(name, size, meaning) pass_all(c, o->name, (size));
#define PASS_NUMBER(name, meaning) pass(c, &o->name);

static void pass_observer(cursor *c, fo_observer *o)
{
    FO_OBSERVER_FIELDS(PASS_MATRIX, PASS_ARRAY, PASS_NUMBER)
}

void fo_pack(const fo_observer *o, uint8_t blob[FO_PACKED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    fo_observer copy;
    copy = *o;
    put_head(blob, OF_PLAIN, needs(o), FO_PACKED_BYTES);
    pass_observer(&c, &copy);
    close_blob(blob, FO_PACKED_BYTES);
}

fo_error fo_unpack(fo_observer *o, const uint8_t *blob, uint32_t length)
{
    const fo_error found = examine(blob, length, OF_PLAIN, FO_PACKED_BYTES);
    if (found == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        pass_observer(&c, o);
#if FO_MAPPED
        o->map = NULL;
#endif
    }
    return found;
}

#if FO_ADAPTIVE
static void pass_adaptive(cursor *c, fo_adaptive *o)
{
    fo_real projection = o->projection == FO_PROJECT_START ? ONE : ZERO;
    pass_observer(c, &o->plain);
    FO_ADAPTIVE_FIELDS(PASS_ARRAY, PASS_NUMBER)
    pass(c, &projection);
    o->projection = projection > ZERO ? FO_PROJECT_START : FO_PROJECT_NEVER;
}

void fo_adaptive_pack(const fo_adaptive *a, uint8_t blob[FO_ADAPTIVE_PACKED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    fo_adaptive copy;
    copy = *a;
    put_head(blob, OF_ADAPTIVE, needs(&a->plain) | (uint32_t)FO_ASYMMETRIC,
             FO_ADAPTIVE_PACKED_BYTES);
    pass_adaptive(&c, &copy);
    close_blob(blob, FO_ADAPTIVE_PACKED_BYTES);
}

fo_error fo_adaptive_unpack(fo_adaptive *a, const uint8_t *blob, uint32_t length)
{
    const fo_error found = examine(blob, length, OF_ADAPTIVE, FO_ADAPTIVE_PACKED_BYTES);
    if (found == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        pass_adaptive(&c, a);
#if FO_MAPPED
        a->plain.map = NULL;
#endif
    }
    return found;
}

/* ---- what has been learnt --------------------------------------------------------------- */

/* A number that observers with other units of what they learn do not have: a checksum. */
static fo_real mark_of(const fo_adaptive *a)
{
    uint8_t bytes[((uint32_t)FO_NP + 3U) * (uint32_t)sizeof(fo_real)];
    cursor c = {bytes, NULL};
    fo_real units[3] = {a->plain.flux_base, a->plain.drift_base, a->plain.sample_time};
    fo_real stds[FO_NP];
    (void)memcpy(stds, a->std, sizeof stds);
    pass_all(&c, units, 3);
    pass_all(&c, stds, (int)FO_NP);
    const uint32_t sum = checksum(bytes, (uint32_t)sizeof bytes) >> 8U;
    return (fo_real)sum; /* 24 bits are exact */
}

/* The parameters' part of the triangle, their values, and those that were assumed. */
typedef struct {
    fo_real p[FO_NP], d[FO_NP], z[FO_NP], U[FO_NP * (FO_NP - 1) / 2], means[FO_MEANS];
} part;

static void pass_part(cursor *c, part *of)
{
    pass_all(c, of->p, (int)FO_NP);
    pass_all(c, of->d, (int)FO_NP);
    pass_all(c, of->z, (int)FO_NP);
    pass_all(c, of->U, (int)FO_NP * ((int)FO_NP - 1) / 2);
    pass_all(c, of->means, (int)FO_MEANS);
}

/* Are they numbers that a filter has? */
static bool usable_part(const part *of)
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
    for (int i = 0; i < (int)FO_MEANS; i++) {
        sum += of->means[i];
    }
    return positive && sum - sum == ZERO;
}

void fo_adaptive_save(const fo_adaptive *a, const fo_adaptive_state *s,
                      uint8_t blob[FO_SAVED_BYTES])
{
    cursor c = {&blob[FO_HEAD], NULL};
    part of;
    fo_real mark = mark_of(a);
    (void)memset(&of, 0, sizeof of);
    (void)memcpy(of.p, s->p, sizeof of.p);
    (void)memcpy(of.d, &s->d[FO_NF], sizeof of.d);
    (void)memcpy(of.z, &s->z[FO_NF], sizeof of.z);
    (void)memcpy(of.U, &s->U[FO_ROW(FO_NA, FO_NF)], sizeof of.U);
    for (int i = 0; i < (int)FO_NP && never_reset(&s->plain); i++) { /* zeros: nothing is learnt */
        of.d[i] = ONE;
    }
    fo_learning_means(a, of.means);
    put_head(blob, OF_SAVED, (uint32_t)FO_ASYMMETRIC, FO_SAVED_BYTES);
    pass(&c, &mark);
    pass_part(&c, &of);
    close_blob(blob, FO_SAVED_BYTES);
}

fo_error fo_adaptive_restore(const fo_adaptive *a, fo_adaptive_state *s, const uint8_t *blob,
                             uint32_t length, fo_real changed)
{
    fo_error found = examine(blob, length, OF_SAVED, FO_SAVED_BYTES);
    fo_adaptive_reset(a, s);
    if (found == FO_OK) {
        cursor c = {NULL, &blob[FO_HEAD]};
        const fo_real std = a->std[FO_RESISTANCE], expected = mark_of(a);
        fo_real mark = ZERO;
        part of;
        pass(&c, &mark);
        pass_part(&c, &of);
        if (!usable_part(&of)) {
            found = FO_ERROR_DAMAGED;
        } else if (mark < expected || mark > expected) {
            found = FO_ERROR_OTHER;
        } else {
            (void)memcpy(s->p, of.p, sizeof of.p);
            (void)memcpy(&s->d[FO_NF], of.d, sizeof of.d);
            (void)memcpy(&s->z[FO_NF], of.z, sizeof of.z);
            (void)memcpy(&s->U[FO_ROW(FO_NA, FO_NF)], of.U, sizeof of.U);
            fo_learning_warm(a, s, std > ZERO ? changed * of.means[1] / std : ZERO);
            fo_learning_rebase(a, s, of.means);
            fo_candidates_sow(a, s);
        }
    }
    return found;
}
#endif
