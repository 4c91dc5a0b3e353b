/* The flux observer as a SimpleFOC sensor instead of an encoder, for SimpleFOC 2.3 or newer
 * (include SimpleFOC.h first).
 *
 * Each time SimpleFOC asks for the angle, this sensor reads the phase currents and the voltage that
 * SimpleFOC has set since the last time, and returns the angle of the magnets. Hence
 * zero_electric_angle is 0, sensor_direction is CW, and no alignment is needed. The angle of the
 * shaft is ambiguous by multiples of 360 degrees divided by the pole pairs.
 *
 * The position is not observable at standstill. Start in open loop; handOver() closes the loop once the
 * position is valid, and opens it again after the position has been lost.
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
    /* Time [s] for which the position must be valid before the loop closes; time [s] for which the
     * position must be lost before the loop opens again; largest standard deviation [rad] at which
     * the loop closes. */
    float settle_time = 0.02f, patience = 0.05f, settled_std = 0.035f;

    /* `parameters` must be those of this motor; voltages in V, currents in A. */
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
        /* SimpleFOC set this voltage after the last update. With the gates off, the voltage is
         * unknown. */
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

    /* Speed of the shaft [rad/s]. */
    float getVelocity() override { return estimate@position@.speed_e / (float)motor.pole_pairs; }

    /* 1 while the position is unknown: initFOC() then turns the motor in open loop, at
     * motor.velocity_index_search. */
    int needsSearch() override { return estimate@position@.valid ? 0 : 1; }

    /* Switches between open_loop and closed_loop; call it after motor.move(). */
    void handOver(MotionControlType open_loop, MotionControlType closed_loop) {
        const bool sure = estimate@position@.theta_e_std < settled_std;
        if (motor.controller == open_loop && valid_for > settle_time && sure) {
            motor.controller = closed_loop;
        } else if (motor.controller == closed_loop && lost_for > patience) {
            /* In open loop the voltage is 90 degrees ahead of this angle, and the magnets follow
             * the voltage. */
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
    int turns = 0;       /* electrical turns within a turn of the shaft */
};

#endif
