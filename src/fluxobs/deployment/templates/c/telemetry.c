/* A frame:
 *
 *   0, 1   0xF1, 0x0B
 *   2      'H' (names) or 'S' (samples)
 *   3      n, the length of the payload
 *   4, 5   number of the first sample, modulo 65536, low byte first
 *   6 ...  payload, n bytes
 *   then   CRC-16 of bytes 2 to 5 + n (polynomial 0x1021, start 0xFFFF), low byte first
 *
 * The payload of 'H' is text: sample time in s, lag in samples, names. The payload of 'S' is, for each
 * name, a float of four bytes, low byte first; a frame may hold several samples. You may add columns.
 */
#include "telemetry.h"

#include <string.h>

enum { MARK_0 = 0xF1, MARK_1 = 0x0B, AHEAD = 6, CHECKED_FROM = 2 };

/* Lag 1: the voltage of a sample acted over the interval that ends at this sample. */
static const char names[] = "@sample_time@,1,u_alpha,u_beta,i_alpha,i_beta";

static unsigned crc(const unsigned char *bytes, unsigned count)
{
    static const uint16_t table[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5,
                                       0x60C6, 0x70E7, 0x8108, 0x9129, 0xA14A, 0xB16B,
                                       0xC18C, 0xD1AD, 0xE1CE, 0xF1EF};
    unsigned out = 0xFFFFU;
    for (unsigned k = 0U; k < count; k++) {
        out = ((out << 4U) ^ table[((out >> 12U) ^ (bytes[k] >> 4U)) & 15U]) & 0xFFFFU;
        out = ((out << 4U) ^ table[((out >> 12U) ^ bytes[k]) & 15U]) & 0xFFFFU;
    }
    return out;
}

static void begin(unsigned char *out, char kind, unsigned length, uint32_t number)
{
    out[0] = (unsigned char)MARK_0;
    out[1] = (unsigned char)MARK_1;
    out[2] = (unsigned char)kind;
    out[3] = (unsigned char)length;
    out[4] = (unsigned char)(number & 255U);
    out[5] = (unsigned char)((number >> 8U) & 255U);
}

static unsigned end(unsigned char *out, unsigned length)
{
    const unsigned last = (unsigned)AHEAD + length;
    const unsigned check = crc(&out[CHECKED_FROM], last - (unsigned)CHECKED_FROM);
    out[last] = (unsigned char)(check & 255U);
    out[last + 1U] = (unsigned char)(check >> 8U);
    return last + 2U;
}

static void put(unsigned char *out, float value)
{
    uint32_t bits;
    (void)memcpy(&bits, &value, sizeof bits);
    for (unsigned k = 0U; k < 4U; k++) {
        out[k] = (unsigned char)((bits >> (8U * k)) & 255U);
    }
}

unsigned telemetry_names(unsigned char out[TELEMETRY_MOST], uint32_t number)
{
    const unsigned length = (unsigned)(sizeof names) - 1U;
    begin(out, 'H', length, number);
    (void)memcpy(&out[AHEAD], names, length);
    return end(out, length);
}

unsigned telemetry_sample(unsigned char out[TELEMETRY_MOST], uint32_t number,
                          const float voltage[2], const float current[2])
{
    begin(out, 'S', 16U, number);
    put(&out[AHEAD], voltage[0]);
    put(&out[AHEAD + 4], voltage[1]);
    put(&out[AHEAD + 8], current[0]);
    put(&out[AHEAD + 12], current[1]);
    return end(out, 16U);
}
