/* Costs of a division, and of a multiplication with an addition, on a processor without a
 * floating-point unit. The variants are emulated single precision, fixed point with a 64-bit
 * product, and fixed point with the upper half of the product, from 16-bit parts. Block floating
 * point would need an additional shift of each row. */
#include "target.h"

enum { COUNT = 64 };

static volatile float floats[3] = {1.37f, 0.83f, 2.19f};
static volatile int32_t fixed[3] = {1370000001, 830000003, 219000007};

static __attribute__((noinline)) uint32_t emulated(void)
{
    float x = floats[0];
    const float a = floats[1], b = floats[2];
    const uint32_t before = target_ticks();
    for (int k = 0; k < COUNT; k++) {
        x -= a * (x * b);
    }
    const uint32_t after = target_ticks();
    floats[0] = x;
    return before - after;
}

static __attribute__((noinline)) uint32_t divided(void)
{
    float x = floats[1];
    const float a = floats[2];
    const uint32_t before = target_ticks();
    for (int k = 0; k < COUNT; k++) {
        x = a / x;
    }
    const uint32_t after = target_ticks();
    floats[1] = x;
    return before - after;
}

static __attribute__((noinline)) uint32_t whole_product(void)
{
    int32_t x = fixed[0];
    const int32_t a = fixed[1], b = fixed[2];
    const uint32_t before = target_ticks();
    for (int k = 0; k < COUNT; k++) {
        x -= (int32_t)(((int64_t)a * (int32_t)(((int64_t)x * b) >> 31)) >> 31);
    }
    const uint32_t after = target_ticks();
    fixed[0] = x;
    return before - after;
}

/* Upper half of a product of numbers below one, to within three of its last digits: the product of
 * the lower parts is omitted. */
static inline int32_t upper(int32_t a, int32_t b)
{
    const int32_t ah = a >> 16, bh = b >> 16;
    const int32_t al = (int32_t)((uint32_t)a & 0xFFFFU) >> 1, bl = (int32_t)((uint32_t)b & 0xFFFFU) >> 1;
    return (ah * bh + ((ah * bl) >> 15) + ((al * bh) >> 15)) * 2;
}

static __attribute__((noinline)) uint32_t upper_half(void)
{
    int32_t x = fixed[0];
    const int32_t a = fixed[1], b = fixed[2];
    const uint32_t before = target_ticks();
    for (int k = 0; k < COUNT; k++) {
        x -= upper(a, upper(x, b));
    }
    const uint32_t after = target_ticks();
    fixed[0] = x;
    return before - after;
}

int main(void)
{
    target_start_ticks();
    const uint32_t first = target_ticks(), second = target_ticks();
    target_number("reading", (int32_t)((first - second) & 0xFFFFFFU));
    target_number("emulated", (int32_t)(emulated() & 0xFFFFFFU));
    target_number("divided", (int32_t)(divided() & 0xFFFFFFU));
    target_number("whole_product", (int32_t)(whole_product() & 0xFFFFFFU));
    target_number("upper_half", (int32_t)(upper_half() & 0xFFFFFFU));
    target_number("parameters", COUNT);
    return 0;
}
