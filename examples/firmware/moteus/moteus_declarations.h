/* The part of the moteus firmware that moteus_fluxobs.h uses: names, types and fields, as facts.
 * Source: github.com/mjbots/moteus, commit db1a7623, fw/bldc_servo_structs.h. The real structures
 * have more fields, in another order.
 *
 * SPDX-License-Identifier: MIT
 */
#pragma once

namespace moteus {

enum BldcServoMode { kStopped = 0, kFault = 1, kPwm = 5, kCurrent = 9, kPosition = 10, kBrake = 15 };

struct Vec3 {
    float a = 0.0f, b = 0.0f, c = 0.0f;
};

struct BldcServoStatus {
    BldcServoMode mode = kStopped;
    float cur1_A = 0.0f, cur2_A = 0.0f, cur3_A = 0.0f;
    float filt_1ms_bus_V = 0.0f;
};

struct BldcServoControl_Control {
    Vec3 pwm; /* 0 to 1; all 0 if no duty was commanded */
};

}
