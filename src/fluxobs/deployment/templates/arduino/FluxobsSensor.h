/* The flux observer in place of an encoder, for SimpleFOC 2.3 or newer (include SimpleFOC.h first).
 *
 * It reads the phase currents each time SimpleFOC asks for the angle, takes the voltage that
 * SimpleFOC has set in the meantime, and tells the angle of the magnets: zero_electric_angle is 0 and
 * sensor_direction CW, nothing has to be aligned. The angle of the shaft is known but for a multiple
 * of 360 degrees over the pole pairs.
 *
 * It cannot see a rotor that stands. Start in open loop; handOver() closes the loop once the position
 * is valid, and opens it again when it has been lost.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_SENSOR_H
#define FLUXOBS_SENSOR_H

#include <math.h>
#include <stdint.h>

#include "@header@"

class FluxobsSensor : public Sensor {
public:
    /* How long the position has to be valid before the loop is closed, and to be lost before it is
     * opened again [s]; largest standard deviation for closing it [rad]. */
    float settle_time = 0.02f, patience = 0.05f, settled_std = 0.035f;

    /* The motor's voltage and the currents, both in V and A; the observer belongs to this motor. */
    FluxobsSensor(const @fo_type@ &parameters, FOCMotor &of_motor, CurrentSense &sense)
        : observer(parameters), motor(of_motor), currents(sense) {}

    void init() override {
        @fo@_reset(&observer, &state);
        last = micros();
        on = false;
        valid_for = lost_for = 0.0f;
        motor.zero_electric_angle = 0.0f;
        motor.sensor_direction = Direction::CW;
    }

    void update() override {
        const uint32_t now = (uint32_t)micros();
        const float duration = 1e-6f * (float)(now - last);
        const ABCurrent_s i = currents.getABCurrents(currents.getPhaseCurrents());
        const fo_real current[FO_N] = {i.alpha, i.beta};
        /* SimpleFOC has set it after the last update. With the gates off it is the motor's own. */
        const bool driven = on && motor.enabled != 0;
        const fo_real voltage[FO_N] = {driven ? motor.Ualpha : NAN, driven ? motor.Ubeta : NAN};
        @fo@_step_for(&observer, &state, duration, voltage, current, &estimate);
        last = now;
        on = motor.enabled != 0;
        const bool valid = estimate@position@.valid;
        valid_for = valid ? valid_for + duration : 0.0f;
        lost_for = valid ? 0.0f : lost_for + duration;
        Sensor::update();
    }

    /* Of the shaft [rad/s]. */
    float getVelocity() override { return estimate@position@.speed_e / (float)motor.pole_pairs; }

    /* 1 while the position is not known: initFOC() then turns the motor in open loop, at
     * motor.velocity_index_search. */
    int needsSearch() override { return estimate@position@.valid ? 0 : 1; }

    /* Call it after motor.move(): changes between this control in open loop and the other one. */
    void handOver(MotionControlType open_loop, MotionControlType closed_loop) {
        const bool sure = estimate@position@.theta_e_std < settled_std;
        if (motor.controller == open_loop && valid_for > settle_time && sure) {
            motor.controller = closed_loop;
        } else if (motor.controller == closed_loop && lost_for > patience) {
            /* In open loop the magnets follow the voltage, 90 degrees ahead of this angle. */
            motor.shaft_angle =
                (estimate@position@.theta_e_tracked - 1.57079633f) / (float)motor.pole_pairs;
            motor.controller = open_loop;
        }
    }

    @fo@_estimate estimate = @fo@_estimate();
    @fo@_state state = @fo@_state();

protected:
    float getSensorAngle() override {
        const float turn = 6.28318531f;
        float angle = estimate@position@.theta_e_tracked; /* -pi to pi */
        angle = angle < 0.0f ? angle + turn : angle;
        if (angle - before > 0.5f * turn) {
            turns = turns > 0 ? turns - 1 : motor.pole_pairs - 1;
        } else if (before - angle > 0.5f * turn) {
            turns = turns + 1 < motor.pole_pairs ? turns + 1 : 0;
        }
        before = angle;
        return ((float)turns * turn + angle) / (float)motor.pole_pairs;
    }

private:
    const @fo_type@ &observer;
    FOCMotor &motor;
    CurrentSense &currents;
    uint32_t last = 0;
    bool on = false;
    float valid_for = 0.0f, lost_for = 0.0f;
    float before = 0.0f; /* electrical angle, 0 to 2 pi [rad] */
    int turns = 0;       /* electrical, within one of the shaft */
};

#endif
