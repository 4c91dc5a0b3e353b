/* Parses simple cells of delimited text as numbers. A simple cell has at most 15 digits and a small
 * exponent, so that one multiplication or division gives the correctly rounded value. The host
 * receives the positions of all other cells. */
#include <stdint.h>

#define EXPORT(name) __attribute__((export_name(#name))) name

enum { MOST_DIGITS = 15, MOST_POWER = 22 };

/* A cell that the host must parse: its row, column and bytes. */
typedef struct {
    uint32_t row, column, begin, end;
} place;

static const double tens[MOST_POWER + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                            1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                            1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

static int is_digit(uint8_t c) { return c >= '0' && c <= '9'; }

/* Parses the number in begin .. end - 1. Returns 0 if the number is not simple. */
static int simple(const uint8_t *begin, const uint8_t *end, uint8_t mark, double *value)
{
    double mantissa = 0.0;
    int sign = 1, digits = 0, power = 0, seen = 0;
    while (begin < end && *begin == ' ') begin++;
    while (end > begin && end[-1] == ' ') end--;
    if (begin < end && (*begin == '-' || *begin == '+')) sign = *begin++ == '-' ? -1 : 1;
    for (; begin < end && is_digit(*begin); begin++, seen = 1) {
        mantissa = mantissa * 10.0 + (*begin - '0');
        digits += mantissa > 0.0;
    }
    if (begin < end && *begin == mark)
        for (begin++; begin < end && is_digit(*begin); begin++, seen = 1, power--) {
            mantissa = mantissa * 10.0 + (*begin - '0');
            digits += mantissa > 0.0;
        }
    if (!seen) return 0;
    if (begin < end && (*begin | 32) == 'e') {
        int up = 1, exponent = 0, any = 0;
        begin++;
        if (begin < end && (*begin == '-' || *begin == '+')) up = *begin++ == '-' ? -1 : 1;
        for (; begin < end && is_digit(*begin) && exponent < 1000; begin++, any = 1)
            exponent = exponent * 10 + (*begin - '0');
        if (!any) return 0;
        power += up * exponent;
    }
    if (begin != end || digits > MOST_DIGITS || power < -MOST_POWER || power > MOST_POWER) return 0;
    *value = sign * (power < 0 ? mantissa / tens[-power] : mantissa * tens[power]);
    return 1;
}

/* Splits a block into columns of numbers, which are `rows` apart in `numbers`.
 *
 * slots[column] >= 0 is the index of the column in `numbers`; -1: the column is not needed; -2: the
 * host needs the positions of its cells, to read them as text. Positions are written to `places`,
 * at most `most` of them. Positions with a column >= `width` are surplus cells that are not empty.
 * If a line ends early, its missing cells are included, with begin = end = the end of the line.
 * Returns the number of positions, or -1 if there are too many; `found` receives the number of
 * rows. */
int32_t EXPORT(part)(const uint8_t *block, uint32_t size, uint8_t delimiter, uint8_t mark,
                     uint32_t width, const int32_t *slots, double *numbers, uint32_t rows,
                     place *places, int32_t most, uint32_t *found)
{
    uint32_t at = 0, row = 0;
    int32_t count = 0;
    while (at < size && row < rows) {
        uint32_t column = 0;
        for (;;) {
            const uint32_t begin = at;
            uint32_t end;
            int quoted = 0;
            if (at < size && block[at] == '"') { /* up to the next single quotation mark */
                quoted = 1;
                for (at++; at < size; at++) {
                    if (block[at] != '"') continue;
                    if (at + 1 >= size || block[at + 1] != '"') break;
                    at++;
                }
            }
            while (at < size && block[at] != delimiter && block[at] != '\n') at++;
            end = at;
            if (end > begin && block[end - 1] == '\r' && (at >= size || block[at] == '\n')) end--;
            const int32_t slot = column < width ? slots[column] : -2;
            int wanted = slot == -2 && (column < width || end > begin);
            if (slot >= 0 && (quoted || !simple(block + begin, block + end, mark,
                                                numbers + (uint32_t)slot * rows + row)))
                wanted = 1;
            if (wanted) {
                if (count >= most) return -1;
                places[count++] = (place){row, column, begin, end};
            }
            column++;
            if (at >= size) break;
            if (block[at++] == '\n') break;
            if (at >= size) { /* an empty cell at the end of the block */
                if (column < width && slots[column] != -1) {
                    if (count >= most) return -1;
                    places[count++] = (place){row, column, at, at};
                }
                column++;
                break;
            }
        }
        for (; column < width; column++) {
            if (slots[column] == -1) continue;
            if (count >= most) return -1;
            places[count++] = (place){row, column, at, at};
        }
        row++;
    }
    *found = row;
    return count;
}

/* Counts a byte in a block. A sum over 240 bytes fits into a byte, so that SIMD adds sixteen bytes
 * at once. */
uint32_t EXPORT(count_of)(const uint8_t *block, uint32_t size, uint8_t byte)
{
    uint32_t n = 0;
    for (uint32_t first = 0; first < size; first += 240) {
        const uint32_t last = size - first < 240 ? size : first + 240;
        uint8_t some = 0;
        for (uint32_t k = first; k < last; k++) some += block[k] == byte;
        n += some;
    }
    return n;
}

/* Whether a block contains these two bytes next to each other. */
uint32_t EXPORT(has_pair)(const uint8_t *block, uint32_t size, uint8_t one, uint8_t other)
{
    uint8_t found = 0;
    for (uint32_t k = 0; k + 1 < size; k++) found |= (block[k] == one) & (block[k + 1] == other);
    return found;
}
