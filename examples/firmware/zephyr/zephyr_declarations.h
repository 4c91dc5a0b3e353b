/* The part of Zephyr, and of ST's low-level drivers in its module hal_stm32, that zephyr_fluxobs.c
 * uses: names, types and macros, as facts. Source: github.com/zephyrproject-rtos/zephyr 4.2:
 * include/zephyr/irq.h, toolchain.h, sys/atomic.h, sys/util_macro.h; hal_stm32: stm32f4xx_ll_adc.h,
 * stm32f4xx_ll_tim.h. The macros expand here to other code than in Zephyr.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef ZEPHYR_DECLARATIONS_H
#define ZEPHYR_DECLARATIONS_H

#include <stdint.h>

#define CONFIG_FPU 1
#define CONFIG_FPU_SHARING 1
#define CONFIG_ZERO_LATENCY_IRQS 1
#define IS_ENABLED(option) (option)
#define BUILD_ASSERT(condition, message) typedef char build_assert_[(condition) ? 1 : -1]

typedef long atomic_t;
typedef long atomic_val_t;
static inline atomic_val_t atomic_get(const atomic_t *target)
{
    return __atomic_load_n(target, __ATOMIC_SEQ_CST);
}
static inline atomic_val_t atomic_inc(atomic_t *target)
{
    return __atomic_fetch_add(target, 1, __ATOMIC_SEQ_CST);
}

#define IRQ_ZERO_LATENCY 1
#define IRQ_DIRECT_CONNECT(irq, priority, isr, flags) ((void)(isr))
#define ISR_DIRECT_DECLARE(name)     \
    static inline int name##_body(void); \
    void name(void);                 \
    void name(void)                  \
    {                                \
        (void)name##_body();         \
    }                                \
    static inline int name##_body(void)
void irq_enable(unsigned int irq);

typedef struct ADC_TypeDef ADC_TypeDef;
typedef struct TIM_TypeDef TIM_TypeDef;
extern ADC_TypeDef *const ADC1, *const ADC2, *const ADC3;
extern TIM_TypeDef *const TIM1;
enum { ADC_IRQn = 18 };
enum { LL_ADC_INJ_RANK_1 = 1, LL_ADC_INJ_RANK_2 = 2 };
void LL_ADC_ClearFlag_JEOS(ADC_TypeDef *adc);
uint16_t LL_ADC_INJ_ReadConversionData12(ADC_TypeDef *adc, uint32_t rank);
uint32_t LL_TIM_GetAutoReload(const TIM_TypeDef *timer);
uint32_t LL_TIM_IsEnabledAllOutputs(const TIM_TypeDef *timer);
uint32_t LL_TIM_OC_GetCompareCH1(const TIM_TypeDef *timer);
uint32_t LL_TIM_OC_GetCompareCH2(const TIM_TypeDef *timer);
uint32_t LL_TIM_OC_GetCompareCH3(const TIM_TypeDef *timer);

#endif
