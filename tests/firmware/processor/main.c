/* Replays the exported test vectors on an emulated processor. The program compares outputs, counts
 * instructions and measures the stack. */
#include <stddef.h>

#include "check.h"
#include "motor_observer.h"
#include "target.h"
#include "vectors.h"

#ifdef ADAPTIVE
#define OBSERVER fo_adaptive
#define STATE fo_adaptive_state
#define ESTIMATE fo_adaptive_estimate
#define RESET fo_adaptive_reset
#ifdef TASKS
#define STEP fo_adaptive_fast_step
#else
#define STEP fo_adaptive_step
#endif
#define PLAIN(observer) (observer).plain
#else
#define OBSERVER fo_observer
#define STATE fo_state
#define ESTIMATE fo_estimate
#define RESET fo_reset
#define STEP fo_step
#define PLAIN(observer) (observer)
#endif

enum { PAINTED = 2048, PAINT = 0x5A, LEARN_EVERY = 10 };

static STATE state;

static volatile unsigned char *stack_pointer(void)
{
    volatile unsigned char *sp;
    __asm__ volatile("mov %0, sp" : "=r"(sp));
    return sp;
}

static __attribute__((noinline)) uint32_t timed_step(int k, ESTIMATE *e)
{
    const uint32_t before = target_ticks();
    STEP(&motor_observer, &state, &samples[k][0], &samples[k][2], e);
    return (before - target_ticks()) & 0xFFFFFFU;
}

#ifdef TASKS
/* A call of the slower task. */
static __attribute__((noinline)) uint32_t timed_learning(void)
{
    const uint32_t before = target_ticks();
    (void)fo_adaptive_learn(&motor_observer, &state);
    return (before - target_ticks()) & 0xFFFFFFU;
}
#endif

/* Paint the memory below the stack's end; a call overwrites the paint where it uses the stack. */
static volatile unsigned char *paint(volatile unsigned char *sp)
{
    volatile unsigned char *const below = sp - PAINTED;
    for (int i = 0; i < PAINTED; i++) {
        below[i] = PAINT;
    }
    return below;
}

static int32_t used(const volatile unsigned char *sp, const volatile unsigned char *below)
{
    while (below < sp && *below == PAINT) {
        below++;
    }
    return (int32_t)(sp - below);
}

static __attribute__((noinline)) uint32_t timed_gathering(void)
{
    static fo_gathered gathered;
    const uint32_t before = target_ticks();
    fo_gather(&PLAIN(motor_observer), &gathered, 0.25f, &samples[0][0], &samples[0][2]);
    return (before - target_ticks()) & 0xFFFFFFU;
}

int main(void)
{
    check_result r;
    ESTIMATE e;
    check_replay(&r);
    target_number("damaged", r.damaged);
    target_number("rows", r.rows);
    target_number("wrong", r.wrong);
    target_number("first_row", r.first_row);
    target_number("first_column", r.first_column);
    target_number("between", r.between);
    target_number("valid", r.valid);
    target_number("flux_error_e9", (int32_t)(r.flux_error < 2.0 ? r.flux_error * 1e9 : 2e9));
    target_number("angle_error_e9", (int32_t)(r.angle_error < 2.0 ? r.angle_error * 1e9 : 2e9));

    /* The host computes sums: the ticks of every step are printed. */
    RESET(&motor_observer, &state);
    target_start_ticks();
    const uint32_t first = target_ticks(), second = target_ticks();
    target_number("ticks_of_reading", (int32_t)((first - second) & 0xFFFFFFU));
    for (int k = 0; k < SAMPLES; k++) {
        target_number("ticks", (int32_t)timed_step(k, &e));
#ifdef TASKS
        if (k % LEARN_EVERY == 0) {
            target_number("learning", (int32_t)timed_learning());
        }
#endif
    }
    target_number("ticks_of_gathering", (int32_t)timed_gathering());

    volatile unsigned char *const sp = stack_pointer(), *below = paint(sp);
    RESET(&motor_observer, &state);
    for (int k = 0; k < SAMPLES; k++) {
        STEP(&motor_observer, &state, &samples[k][0], &samples[k][2], &e);
#ifdef TASKS
        state.mail.owner = 0U; /* as if there were no work for the slower task */
#endif
    }
    target_number("stack", used(sp, below));
#ifdef TASKS
    int32_t deepest = 0;
    RESET(&motor_observer, &state);
    for (int k = 0; k < SAMPLES; k++) {
        STEP(&motor_observer, &state, &samples[k][0], &samples[k][2], &e);
        below = paint(sp);
        (void)fo_adaptive_learn(&motor_observer, &state);
        const int32_t stack = used(sp, below);
        deepest = stack > deepest ? stack : deepest;
    }
    target_number("learning_stack", deepest);
#endif
    target_number("state", (int32_t)sizeof(STATE));
    target_number("parameters", (int32_t)sizeof(OBSERVER));
    return r.damaged || r.wrong > 0 || r.between || r.valid == 0 ? 1 : 0;
}
