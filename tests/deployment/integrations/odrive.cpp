/* Plays the ODrive firmware: its control loop, for motor 0. */
#include "motor.h"

#include "motor_observer.h"
#include "odrive_declarations.hpp"

bool fluxobs_update(Axis &axis);

int main(int argc, char **argv) {
    Motor m;
    SensorlessEstimator estimator;
    Axis axis(m, estimator);
    m.config_.pole_pairs = motor_pole_pairs;
    double u[2] = {0.0, 0.0}, old[2], abc[3];
    motor_start(argc, argv, 1.25e-4);
    while (!motor_done()) {
        const bool on = motor_gates();
        if (on != m.is_armed_) {
            m.is_armed_ = on;
            m.control_law_ = on ? &m.current_control_ : nullptr;
        }
        motor_currents(abc);
        m.current_meas_ = on ? Iph_ABC_t{(float)abc[0], (float)abc[1], (float)abc[2]}
                             : Iph_ABC_t{0.0f, 0.0f, 0.0f};
        estimator.phase_.reset();
        estimator.phase_vel_.reset();
        estimator.vel_estimate_.reset();
        fluxobs_update(axis);
        const auto phase = estimator.phase_.present();
        const double turns = estimator.vel_estimate_.present().value_or(0.0f);
        motor_judge(phase.has_value(), phase.value_or(0.0f), TURN * motor_pole_pairs * turns,
                    (double)TIM1_INIT_COUNT / TIM_1_8_CLOCK_HZ);
        memcpy(old, u, sizeof u);
        motor_command(1.5, u);
        if (on) {
            m.current_control_.final_v_alpha_ = (float)u[0];
            m.current_control_.final_v_beta_ = (float)u[1];
        }
        motor_half(old);
        motor_half(old);
    }
    motor_report();
    return 0;
}
