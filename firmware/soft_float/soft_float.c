/* Single precision for processors without a floating-point unit, a Cortex-M0 for instance: takes the
 * place of the compiler's routines when it is linked. IEEE 754, rounded to nearest, ties to even: the
 * same bits, NaNs excepted, whose payload is one of its own; numbers below 1.2e-38 are zero.
 *
 * It needs a quick multiplication of 32 bits, and no more. Compile it with -Os, which is the quicker
 * one here. Each function takes and returns the bits of numbers.
 *
 * SPDX-License-Identifier: MIT
 */
#include <stdint.h>

uint32_t fo_soft_add(uint32_t a, uint32_t b);
uint32_t fo_soft_subtract(uint32_t a, uint32_t b);
uint32_t fo_soft_multiply(uint32_t a, uint32_t b);
uint32_t fo_soft_divide(uint32_t a, uint32_t b);

#define SIGN 0x80000000U
#define INFINITE 0x7F800000U
#define NOT_A_NUMBER 0x7FC00000U
#define HIDDEN 0x00800000U /* the leading one, which is not stored */
#define FRACTION 0x007FFFFFU

/* Is its exponent neither that of zero nor that of infinity? */
static inline int ordinary(uint32_t exponent) { return exponent - 1U < 254U; }

/* Sign, exponent and a fraction with its leading one at bit 31, of which the lowest eight are to be
 * rounded away; `exponent` is that of a number whose leading one is there. */
static inline uint32_t rounded(uint32_t sign, int32_t exponent, uint32_t fraction)
{
    uint32_t result;
    if ((uint32_t)(exponent - 1) < 254U) {
        const uint32_t rest = fraction & 0xFFU;
        /* the leading one adds one to the exponent, and so does a carry, into infinity too */
        result = ((uint32_t)(exponent - 1) << 23) + (fraction >> 8);
        if (rest > 0x80U || (rest == 0x80U && (result & 1U) != 0U)) {
            result++;
        }
    } else if (exponent > 254) {
        result = INFINITE;
    } else {
        /* what rounds up to the smallest ordinary number is one */
        result = exponent == 0 && fraction >= 0xFFFFFF00U ? HIDDEN : 0U;
    }
    return result | sign;
}

uint32_t fo_soft_multiply(uint32_t a, uint32_t b)
{
    const uint32_t sign = (a ^ b) & SIGN;
    const uint32_t ea = (a >> 23) & 0xFFU, eb = (b >> 23) & 0xFFU;
    if (ordinary(ea) && ordinary(eb)) {
        const uint32_t ma = (a & FRACTION) | HIDDEN, mb = (b & FRACTION) | HIDDEN;
        const uint32_t ah = ma >> 16, al = ma & 0xFFFFU, bh = mb >> 16, bl = mb & 0xFFFFU;
        const uint32_t low = al * bl;
        /* bits 16 to 47 of the product; what is below only matters as something or nothing */
        uint32_t product = ((ah * bh) << 16) + ah * bl + al * bh + (low >> 16);
        int32_t exponent = (int32_t)(ea + eb) - 126;
        product |= (low & 0xFFFFU) != 0U ? 1U : 0U;
        if ((product & SIGN) == 0U) {
            product <<= 1;
            exponent--;
        }
        return rounded(sign, exponent, product);
    }
    if (ea == 255U || eb == 255U) { /* infinite, or not a number */
        const uint32_t na = a << 1, nb = b << 1;
        const int wrong = na > 0xFF000000U || nb > 0xFF000000U || ea == 0U || eb == 0U;
        return wrong ? NOT_A_NUMBER : sign | INFINITE;
    }
    return sign;
}

uint32_t fo_soft_add(uint32_t a, uint32_t b)
{
    /* the larger one first */
    if ((a << 1) < (b << 1)) {
        const uint32_t swap = a;
        a = b;
        b = swap;
    }
    const uint32_t ea = (a >> 23) & 0xFFU, eb = (b >> 23) & 0xFFU;
    if (ordinary(ea) && eb != 0U) {
        const uint32_t sign = a & SIGN, shift = ea - eb;
        int32_t exponent = (int32_t)ea;
        uint32_t ma = ((a & FRACTION) | HIDDEN) << 7, mb = ((b & FRACTION) | HIDDEN) << 7;
        if (shift > 0U) {
            if (shift < 32U) {
                const uint32_t lost = mb << (32U - shift);
                mb = (mb >> shift) | (lost != 0U ? 1U : 0U);
            } else {
                mb = 1U;
            }
        }
        if (((a ^ b) & SIGN) == 0U) {
            ma += mb;
        } else {
            ma -= mb;
            if (ma == 0U) {
                return 0U;
            }
        }
        if ((ma & SIGN) != 0U) {
            exponent++; /* the leading one is at bit 31 */
        } else {
            ma <<= 1;
            for (; ma < 0x00800000U; ma <<= 8) {
                exponent -= 8;
            }
            for (; (ma & SIGN) == 0U; ma <<= 1) {
                exponent--;
            }
        }
        return rounded(sign, exponent, ma);
    }
    if (ea == 255U) { /* infinite, or not a number */
        const int wrong = (a << 1) > 0xFF000000U || (eb == 255U && a != b);
        return wrong ? NOT_A_NUMBER : a;
    }
    if (ea != 0U) { /* b is zero */
        return a;
    }
    return a & b & SIGN; /* both are: -0 only for two of them */
}

uint32_t fo_soft_subtract(uint32_t a, uint32_t b) { return fo_soft_add(a, b ^ SIGN); }

uint32_t fo_soft_divide(uint32_t a, uint32_t b)
{
    const uint32_t sign = (a ^ b) & SIGN;
    const uint32_t ea = (a >> 23) & 0xFFU, eb = (b >> 23) & 0xFFU;
    if (ordinary(ea) && ordinary(eb)) {
        uint32_t rest = (a & FRACTION) | HIDDEN;
        const uint32_t by = (b & FRACTION) | HIDDEN;
        int32_t exponent = (int32_t)ea - (int32_t)eb + 127;
        uint32_t quotient = 1U;
        if (rest < by) {
            rest <<= 1;
            exponent--;
        }
        rest -= by;
        for (int bit = 0; bit < 25; bit++) {
            rest <<= 1;
            quotient <<= 1;
            if (rest >= by) {
                rest -= by;
                quotient++;
            }
        }
        return rounded(sign, exponent, (quotient << 6) | (rest != 0U ? 1U : 0U));
    }
    const int whole_a = (a << 1) > 0xFF000000U, whole_b = (b << 1) > 0xFF000000U;
    if (whole_a || whole_b || (ea == 255U && eb == 255U) || (ea == 0U && eb == 0U)) {
        return NOT_A_NUMBER;
    }
    return ea == 255U || eb == 0U ? sign | INFINITE : sign;
}

#if defined(__ARM_EABI__) && !defined(__ARM_FP)
/* The names by which compilers call them. */
#define NAMED(name, function, first, second)    \
    uint32_t name(uint32_t a, uint32_t b);      \
    uint32_t name(uint32_t a, uint32_t b) { return function(first, second); }
NAMED(__aeabi_fadd, fo_soft_add, a, b)
NAMED(__aeabi_fsub, fo_soft_subtract, a, b)
NAMED(__aeabi_frsub, fo_soft_subtract, b, a)
NAMED(__aeabi_fmul, fo_soft_multiply, a, b)
NAMED(__aeabi_fdiv, fo_soft_divide, a, b)
#endif
