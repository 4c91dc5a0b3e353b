#include "check.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "@prefix@_observer.h"
#include "vectors.h"

enum { LENGTH = @psi_f_column@, VALID = @valid_column@, ANGLE = @angle_column@ };

static const double TURN = 6.283185307179586;
static @fo@_state state;

/* Calls the observer as the example interrupt does. If the observer steps only every few
 * interrupts, the row's voltage acts in all these interrupts, and the current is interpolated
 * linearly between rows. */
static void step(int row, fo_gathered *gathered, @fo@_estimate *estimate)
{
    const fo_real *voltage = &samples[row][0], *current = &samples[row][2];
    const int every = @prefix@_update_every;
    const fo_real share = (fo_real)1 / (fo_real)every;
    fo_real before[FO_N];
    if (every == 1) {
        @fo@_step(&@prefix@_observer, &state, voltage, current, estimate);
        return;
    }
    before[0] = gathered->current[0];
    before[1] = gathered->current[1];
    for (int k = 1; k < every; k++) {
        const fo_real part = (fo_real)k * share;
        const fo_real between[FO_N] = {before[0] + part * (current[0] - before[0]),
                                       before[1] + part * (current[1] - before[1])};
        fo_gather(&@prefix@_observer@plain@, gathered, share, voltage, between);
    }
    fo_gather(&@prefix@_observer@plain@, gathered, share, voltage, current);
    @fo@_step_volt_seconds(&@prefix@_observer, &state, gathered->volt_seconds, current, estimate);
    gathered->volt_seconds[0] = (fo_real)0;
    gathered->volt_seconds[1] = (fo_real)0;
}

/* FNV-1a of a number, least significant byte first; a missing number counts as 0. */
static uint32_t checksum(uint32_t before, fo_real number)
{
    const fo_real value = number == number ? number : (fo_real)0;
    uint32_t sum = before;
#if FO_SINGLE
    uint32_t bits;
#else
    uint64_t bits;
#endif
    memcpy(&bits, &value, sizeof bits);
    for (unsigned byte = 0; byte < sizeof bits; byte++) {
        sum = (sum ^ (uint32_t)((bits >> (8U * byte)) & 0xFFU)) * 0x01000193U;
    }
    return sum;
}

static int damaged(void)
{
    uint32_t sum = 0x811C9DC5U;
    for (int row = 0; row < SAMPLES; row++) {
        for (int column = 0; column < 4; column++) {
            sum = checksum(sum, samples[row][column]);
        }
    }
    for (int row = 0; row < SAMPLES / EVERY; row++) {
        for (int column = 0; column < EXPECTED_COLUMNS; column++) {
            sum = checksum(sum, expected[row][column]);
        }
    }
    return sum != expected_checksum;
}

static double larger(double a, double b) { return a > b ? a : b; }

void check_replay(check_result *r)
{
    static const check_result none = {0, 0, 0, 0, 0, 0, 0, 0.0, 0.0};
    static const fo_gathered nothing = {{(fo_real)0, (fo_real)0}, {(fo_real)0, (fo_real)0}};
    fo_gathered gathered = nothing;
    @fo@_estimate e;
    double flux_scale = 0.0;
    uint32_t all = 0x811C9DC5U;
    *r = none;
    r->damaged = damaged();
    for (int row = 0; row < SAMPLES / EVERY; row++) {
        flux_scale = larger(flux_scale, (double)expected[row][LENGTH]);
    }
    @fo@_reset(&@prefix@_observer, &state);
    for (int k = 0; k < SAMPLES; k++) {
        step(k, &gathered, &e);
        const fo_real found[EXPECTED_COLUMNS] = {
@found@
        };
        for (int column = 0; column < EXPECTED_COLUMNS; column++) {
            all = checksum(all, found[column]);
        }
        if ((k + 1) % EVERY != 0) {
            continue;
        }
        const fo_real *right = expected[k / EVERY];
        int first = EXPECTED_COLUMNS;
        for (int column = EXPECTED_COLUMNS - 1; column >= 0; column--) {
            const double off = fabs((double)found[column] - (double)right[column]);
            if (column < 2) {
                r->flux_error = larger(r->flux_error, off / flux_scale);
            }
            if (column == ANGLE) {
                r->angle_error = larger(r->angle_error, fabs(remainder(off, TURN)));
            }
            if (!(off <= 0.0)) {
                first = column;
            }
        }
        if (first < EXPECTED_COLUMNS) {
            if (r->wrong == 0) {
                r->first_row = k;
                r->first_column = first;
            }
            r->wrong++;
        }
        r->valid += found[VALID] != (fo_real)0 ? 1 : 0;
        r->rows++;
    }
    r->between = r->wrong == 0 && all != every_checksum;
}
