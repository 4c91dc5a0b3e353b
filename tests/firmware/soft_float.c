/* The arithmetic of soft_float.c beside this computer's: random numbers, near ones, exponents at the
 * edges, ties, what is not finite. Numbers below the smallest ordinary one count as zero. */
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

uint32_t fo_soft_add(uint32_t a, uint32_t b);
uint32_t fo_soft_subtract(uint32_t a, uint32_t b);
uint32_t fo_soft_multiply(uint32_t a, uint32_t b);
uint32_t fo_soft_divide(uint32_t a, uint32_t b);

enum { PAIRS = 3000000 };
static const uint32_t SPECIAL[] = {0x00000000U, 0x80000000U, 0x7F800000U, 0xFF800000U, 0x7FC00000U,
                                   0x7F7FFFFFU, 0x00800000U, 0x3F800000U, 0xBF800000U, 0x7F800001U,
                                   0x00FFFFFFU, 0x3F7FFFFFU, 0x34000000U};

static uint32_t next(void)
{
    static uint64_t state = 88172645463325252U;
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)(state >> 16);
}

static float number(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint32_t bits_of(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static uint32_t flushed(uint32_t x) { return (x & 0x7F800000U) == 0U ? x & 0x80000000U : x; }
static int is_nan(uint32_t x) { return (x << 1) > 0xFF000000U; }

int main(void)
{
    const size_t specials = sizeof SPECIAL / sizeof SPECIAL[0];
    int wrong = 0;
    for (int k = 0; k < PAIRS; k++) {
        uint32_t a = next(), b = next();
        switch (next() % 8U) {
        case 0: b = (b & 0x807FFFFFU) | (a & 0x7F800000U); break;
        case 1: b = (b & 0x807FFFFFU) | (((a >> 23) + next() % 64U - 32U) & 0xFFU) << 23; break;
        case 2: b = a ^ next() % 4U ^ (next() & 1U) << 31; break;
        case 3: a = SPECIAL[next() % specials]; break;
        case 4: b = SPECIAL[next() % specials]; break;
        case 5: a &= 0xFFFFF000U; b &= 0xFFFFF000U; break;
        default: break;
        }
        a = flushed(a);
        b = flushed(b);
        const volatile float x = number(a), y = number(b);
        const float right[4] = {x + y, x - y, x * y, x / y};
        const uint32_t found[4] = {fo_soft_add(a, b), fo_soft_subtract(a, b), fo_soft_multiply(a, b),
                                   fo_soft_divide(a, b)};
        for (int n = 0; n < 4; n++) {
            const uint32_t wanted = flushed(bits_of(right[n]));
            if (wanted != found[n] && !(is_nan(wanted) && is_nan(found[n]))) {
                if (wrong < 10) {
                    printf("%c of %08" PRIx32 " and %08" PRIx32 ": %08" PRIx32 " for %08" PRIx32 "\n",
                           "+-*/"[n], a, b, found[n], wanted);
                }
                wrong++;
            }
        }
    }
    return wrong > 0;
}
