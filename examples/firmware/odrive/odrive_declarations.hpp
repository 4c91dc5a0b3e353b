/* The part of the ODrive firmware that odrive_fluxobs.cpp uses: names, types and fields, as facts.
 * Source: github.com/odriverobotics/ODrive, commit f9b5419c (fw-v0.5.6). Firmware/MotorControl/:
 * component.hpp (OutputPort), foc.hpp, motor.hpp, sensorless_estimator.hpp, axis.hpp.
 * Firmware/Board/v3/Inc/: board.h, main.h. The real classes have more members, in another order.
 *
 * SPDX-License-Identifier: MIT
 */
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>

#define TIM_1_8_CLOCK_HZ 168000000
#define TIM_1_8_PERIOD_CLOCKS 3500
#define TIM1_INIT_COUNT (TIM_1_8_PERIOD_CLOCKS / 2 - 1 * 128)

struct Iph_ABC_t {
    float phA, phB, phC; /* [A] */
};

template <typename T>
class OutputPort {
public:
    OutputPort(T value) : content_(value) {}
    void operator=(T value) {
        content_ = value;
        age_ = 0;
    }
    void reset() { age_++; }
    std::optional<T> present() { return age_ == 0 ? std::optional<T>(content_) : std::nullopt; }

private:
    uint32_t age_ = 2; /* control loops since the value was set */
    T content_;
};

template <size_t N_PHASES>
class PhaseControlLaw {};

class FieldOrientedController : public PhaseControlLaw<3> {
public:
    float final_v_alpha_ = 0.0f, final_v_beta_ = 0.0f; /* commanded [V] */
};

class Motor {
public:
    struct Config_t {
        int32_t pole_pairs = 7;
    };
    Config_t config_;
    bool is_armed_ = false;
    std::optional<Iph_ABC_t> current_meas_;
    FieldOrientedController current_control_;
    PhaseControlLaw<3> *control_law_ = nullptr;
};

class SensorlessEstimator {
public:
    OutputPort<float> phase_ = 0.0f;        /* [rad] */
    OutputPort<float> phase_vel_ = 0.0f;    /* electrical [rad/s] */
    OutputPort<float> vel_estimate_ = 0.0f; /* speed of the shaft [turns/s] */
};

class Axis {
public:
    explicit Axis(Motor &motor, SensorlessEstimator &estimator)
        : sensorless_estimator_(estimator), motor_(motor) {}
    int axis_num_ = 0;
    SensorlessEstimator &sensorless_estimator_;
    Motor &motor_;
};
