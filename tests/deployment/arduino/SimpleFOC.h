/* The declarations of SimpleFOC 2.4.0 (Sensor.h, FOCMotor.h, CurrentSense.h, foc_utils.h and drivers)
 * that the exported sensor and its example use, with the minimal behaviour for a simulated motor.
 * Names, types and defaults are those of SimpleFOC; the function bodies are not. */
#pragma once
#include "Arduino.h"

enum Direction : int8_t { CW = 1, CCW = -1, UNKNOWN = 0 };
enum MotionControlType : uint8_t { torque, velocity, angle, velocity_openloop, angle_openloop };
enum TorqueControlType : uint8_t { voltage, dc_current, foc_current };
enum FOCModulationType : uint8_t { SinePWM, SpaceVectorPWM };
struct PhaseCurrent_s { float a, b, c; };
struct ABCurrent_s { float alpha, beta; };
struct DQVoltage_s { float d, q; };

class Sensor {
public:
    virtual float getMechanicalAngle() { return angle_prev; }
    virtual float getAngle() { return (float)full_rotations * 6.28318531f + angle_prev; }
    virtual float getVelocity() { return velocity; }
    virtual void update() {
        const float angle = getSensorAngle(), step = angle - angle_prev;
        if (std::fabs(step) > 0.8f * 6.28318531f) full_rotations += step > 0 ? -1 : 1;
        angle_prev = angle;
    }
    virtual int needsSearch() { return 0; }

protected:
    virtual float getSensorAngle() = 0;
    virtual void init() {}
    float velocity = 0.0f, angle_prev = 0.0f;
    int32_t full_rotations = 0;
};

class BLDCDriver3PWM {
public:
    BLDCDriver3PWM(int, int, int, int) {}
    float voltage_power_supply = 12.0f;
    int init() { return 1; }
};

class CurrentSense {
public:
    virtual int init() { return 1; }
    virtual PhaseCurrent_s getPhaseCurrents() = 0;
    ABCurrent_s getABCurrents(PhaseCurrent_s i) {
        return {i.a, 0.57735027f * (i.a + 2.0f * i.b)};
    }
    void linkDriver(BLDCDriver3PWM *) {}
};

class InlineCurrentSense : public CurrentSense {
public:
    InlineCurrentSense(float, float, int, int) {}
    PhaseCurrent_s getPhaseCurrents() override { return {0.0f, 0.0f, 0.0f}; }
};

class FOCMotor {
public:
    float shaft_angle = 0.0f, Ualpha = 0.0f, Ubeta = 0.0f, current_limit = 1.0f;
    float zero_electric_angle = -12345.0f, velocity_index_search = 1.0f;
    int pole_pairs = 1;
    int8_t enabled = 0;
    Direction sensor_direction = Direction::UNKNOWN;
    MotionControlType controller = MotionControlType::torque;
    TorqueControlType torque_controller = TorqueControlType::voltage;
    FOCModulationType foc_modulation = FOCModulationType::SinePWM;
    void linkSensor(Sensor *linked) { sensor = linked; }
    void linkCurrentSense(CurrentSense *) {}
    virtual int initFOC() { return 1; }
    virtual void loopFOC() {}
    virtual void move(float) {}
    Sensor *sensor = nullptr;
};

class BLDCMotor : public FOCMotor {
public:
    explicit BLDCMotor(int pairs) { pole_pairs = pairs; }
    int init() { return 1; }
    void linkDriver(BLDCDriver3PWM *) {}
};
