/* Tasks of a drive beside its interrupt: a motor chosen in the field, a start from Hall sensors, a
 * winding that warms up, an estimate for slower tasks, data that survive a power cycle.
 *
 * For an export with --unknowns drift,resistance,inverter. Without this option the names of the
 * functions do not contain `adaptive`. You write the functions that are declared here.
 *
 * SPDX-License-Identifier: MIT
 */
#include <math.h>

#include "fluxobs_config.h"
#include "fluxobs_keep.h"
#include "fluxobs_retune.h"
#include "fluxobs_seed.h"
#include "motor_config.h"
#include "motor_observer.h"

const uint8_t *memory_read(uint32_t *length); /* 0 if nothing was stored */
void memory_write(const uint8_t *bytes, uint32_t length);
void complain(const char *field);
float hall_angle(void); /* electrical angle of the sector's middle [rad] */
bool hall_is_read(void);

void usual_motor(void);
bool choose_motor(const uint8_t *blob, uint32_t length);
bool describe_motor(float R_s, float L_s, float psi_f, float rated_current);
void power_up(void);
void control_interrupt(const float voltage[2], const float current[2]);
void every_second(float winding_temperature);
void control_speed(void);
void power_down(void);

static fo_adaptive observer;           /* parameters of the motor, in RAM */
static fo_adaptive_retunable in_use;   /* parameters in use and their successor */
static fo_adaptive_state state;
static fo_adaptive_estimate estimate;
static fo_snapshot shared;
static fo_config config;               /* configuration of the motor in use */
static fo_adaptive_config adaptive;
static bool config_known;              /* a blob does not contain the configuration */

/* For a motor whose motor_parameters.bin was exported on a PC. If it needs a flux map, give the map
 * to fo_use_map(&observer.plain, ...) here. */
bool choose_motor(const uint8_t *blob, uint32_t length)
{
    config_known = false;
    return fo_adaptive_unpack(&observer, blob, length) == FO_OK;
}

/* For a motor of which only the data sheet is known: the formulas of `fluxobs export`. */
bool describe_motor(float R_s, float L_s, float psi_f, float rated_current)
{
    const fo_machine machine = fo_pmsm(R_s, L_s, psi_f, rated_current);
    const char *wrong = fo_configure(&config, &machine, motor_step_time);
    config_known = false;
    if (wrong != NULL) {
        complain(wrong); /* "R_s": it is in milliohms, or not positive */
        return false;
    }
    fo_adaptive_choose(&adaptive, &machine, motor_step_time, 48.0f,
                       (uint32_t)FO_LEARN_RESISTANCE + (uint32_t)FO_LEARN_INVERTER);
    if (fo_adaptive_init(&observer, &config, &adaptive) != FO_OK) {
        complain(fo_adaptive_wrong(&config, &adaptive));
        return false;
    }
    config_known = true;
    return true;
}

/* For the motor of this export. */
void usual_motor(void)
{
    observer = motor_observer;
    config = motor_config;
    adaptive = motor_adaptive_config;
    config_known = true;
}

/* Call this before the interrupt runs: it restores what was learnt. The winding may have cooled, so
 * that the resistance may be wrong by a fifth. */
void power_up(void)
{
    uint32_t length = 0;
    const uint8_t *saved = memory_read(&length);
    fo_adaptive_retunable_init(&in_use, &observer);
    if (saved == NULL ||
        fo_adaptive_restore(&observer, &state, saved, length, 0.2f) != FO_OK) {
        fo_adaptive_reset(&observer, &state);
    }
}

/* Interrupt of the current control. */
void control_interrupt(const float voltage[2], const float current[2])
{
    const fo_adaptive *now = fo_adaptive_take(&in_use, &state);
    if (hall_is_read()) { /* once, at rest: a sector of 60 degrees has a std of 0.3 rad */
        const fo_seed seed = {hall_angle(), 0.3f, 0.0f, 0.0f, 0.0f, 0.0f};
        fo_adaptive_seed_state(now, &state, &seed, current);
        return;
    }
    fo_adaptive_step(now, &state, voltage, current, &estimate);
    fo_publish(&shared, &estimate.position);
}

/* The assumed resistance follows the winding's temperature sensor; the learnt difference stays.
 * Change only fields of the configuration in use, but not its bases: psi changes in
 * adaptive.psi_f. */
void every_second(float winding_temperature)
{
    fo_config warm = config;
    if (!config_known) {
        return;
    }
    const float copper = 1.0f + 0.0039f * (winding_temperature - 20.0f);
    warm.R[0][0] = warm.R[1][1] = config.R[0][0] * copper;
    const fo_error error = fo_adaptive_retune(&in_use, &warm, &adaptive);
    if (error != FO_OK && error != FO_ERROR_BUSY) { /* if busy, the next second will do */
        complain("R");
    }
}

/* A task that is slower than the interrupt, and that the interrupt may interrupt. */
void control_speed(void)
{
    fo_estimate now;
    if (fo_read(&shared, &now) && now.valid) {
        /* now.speed_e / motor_pole_pairs */
    }
}

/* Call this when the interrupt no longer runs. */
void power_down(void)
{
    uint8_t saved[FO_SAVED_BYTES];
    fo_adaptive_save(fo_adaptive_take(&in_use, &state), &state, saved);
    memory_write(saved, FO_SAVED_BYTES);
}
