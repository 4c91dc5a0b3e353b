/* Simulates Zephyr, the ADC and the timer of an STM32. */
#include "motor.h"

#include "zephyr_declarations.h"

#ifndef ACTS_AFTER
#define ACTS_AFTER 0.5f
#endif

struct fluxobs_position {
    float theta_e, speed_e;
    bool valid;
};
void motor_control(const float current[2], float udc, const struct fluxobs_position *position);
void fluxobs_zephyr_start(void);
struct fluxobs_position fluxobs_zephyr_get(void);
void fluxobs_adc_isr(void);

struct ADC_TypeDef {
    int phase;
};
struct TIM_TypeDef {
    uint32_t compare[3];
};
static ADC_TypeDef adc[3] = {{0}, {1}, {2}};
static TIM_TypeDef timer;
ADC_TypeDef *const ADC1 = &adc[0], *const ADC2 = &adc[1], *const ADC3 = &adc[2];
TIM_TypeDef *const TIM1 = &timer;
static const uint32_t RELOAD = 8400;
static double commanded[2];

void irq_enable(unsigned int irq) { (void)irq; }
void LL_ADC_ClearFlag_JEOS(ADC_TypeDef *which) { (void)which; }
uint32_t LL_TIM_GetAutoReload(const TIM_TypeDef *which) { (void)which; return RELOAD; }
uint32_t LL_TIM_IsEnabledAllOutputs(const TIM_TypeDef *which) { (void)which; return motor_gates(); }
uint32_t LL_TIM_OC_GetCompareCH1(const TIM_TypeDef *which) { return which->compare[0]; }
uint32_t LL_TIM_OC_GetCompareCH2(const TIM_TypeDef *which) { return which->compare[1]; }
uint32_t LL_TIM_OC_GetCompareCH3(const TIM_TypeDef *which) { return which->compare[2]; }

/* The ADC has 12 bits for 3.3 V. It measures the current to ground as 50 mV/A around the middle,
 * and the bus voltage divided by 31. */
uint16_t LL_ADC_INJ_ReadConversionData12(ADC_TypeDef *which, uint32_t rank)
{
    double abc[3];
    motor_currents(abc);
    const double volts = rank == LL_ADC_INJ_RANK_1 ? 1.65 - 0.05 * abc[which->phase] : BUS / 31.0;
    return (uint16_t)lrint(volts / 3.3 * 4096.0);
}

void motor_control(const float current[2], float udc, const struct fluxobs_position *position)
{
    (void)current;
    (void)udc;
    (void)position;
    double duty[3];
    motor_command(0.5 + ACTS_AFTER, commanded);
    motor_duties(commanded, duty);
    for (int n = 0; n < 3; n++) {
        timer.compare[n] = (uint32_t)lrint(duty[n] * RELOAD);
        duty[n] = (double)timer.compare[n] / RELOAD;
    }
    motor_voltage(duty, commanded);
}

int main(int argc, char **argv)
{
    double old[2] = {0.0, 0.0};
    motor_start(argc, argv, 1e-4);
    fluxobs_zephyr_start();
    while (!motor_done()) {
        fluxobs_adc_isr();
        const struct fluxobs_position now = fluxobs_zephyr_get();
        motor_judge(now.valid, now.theta_e, now.speed_e, 0.0);
        motor_half(old);
        motor_half(ACTS_AFTER < 1.0f ? commanded : old);
        memcpy(old, commanded, sizeof old);
    }
    motor_report();
    return 0;
}
