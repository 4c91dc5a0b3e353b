/* For an exported folder: compares the class of fluxobs.hpp with the C functions, sample by
 * sample. */
#include <stdio.h>
#include <string.h>

#include "fluxobs.hpp"
#include "motor_observer.h"
#include "vectors.h"

#ifdef ADAPTIVE
using Motor = fluxobs::Observer<fo_adaptive>;
static void reset(Motor::State &s) { fo_adaptive_reset(&motor_observer, &s); }
static void step(Motor::State &s, const fo_real *row, Motor::Estimate &e) {
    fo_adaptive_step(&motor_observer, &s, row, row + 2, &e);
}
static const fo_estimate &position(const Motor::Estimate &e) { return e.position; }
#else
using Motor = fluxobs::Observer<fo_observer>;
static void reset(Motor::State &s) { fo_reset(&motor_observer, &s); }
static void step(Motor::State &s, const fo_real *row, Motor::Estimate &e) {
    fo_step(&motor_observer, &s, row, row + 2, &e);
}
static const fo_estimate &position(const Motor::Estimate &e) { return e; }
#endif

int main() {
    Motor motor(motor_observer);
    Motor::State state;
    Motor::Estimate e;
    int valid = 0;
    reset(state);
    for (int k = 0; k < SAMPLES; k++) {
        const fo_real *row = samples[k];
        (void)motor.step({row[0], row[1]}, {row[2], row[3]});
        step(state, row, e);
        if (memcmp(&motor.position().flux, &position(e).flux, sizeof e) == 0 ||
            motor.position().theta_e == position(e).theta_e) {
            valid += motor.position().valid ? 1 : 0;
        } else {
            printf("sample %d differs\n", k);
            return 1;
        }
    }
    if (motor.counts().restarts == 0U || valid == 0) {
        printf("%d valid\n", valid);
        return 1;
    }
    fo_seed at = {};
    at.theta_e = fo_real(1);
    at.theta_e_std = fo_real(0.05);
    motor.seed(at, {0, 0});
    (void)motor.step({0, 0}, {0, 0});
    const double off = static_cast<double>(motor.position().theta_e) - 1.0;
    return off * off < 1e-4 ? 0 : 1;
}
