/* The flux observer as a level-2 S-function. UNTESTED in Simulink: compiled and run against a stand-in
 * for its headers only. Please report what you find.
 *
 * Input: u_alpha, u_beta [V], mean over the interval that ends now; i_alpha, i_beta [A], now.
 * Output: @names@.
 *
 * SPDX-License-Identifier: MIT
 */
#define S_FUNCTION_NAME @name@
#define S_FUNCTION_LEVEL 2

#include <string.h>

#include "simstruc.h"

#include "@prefix@_observer.h"

enum { INPUTS = 4, OUTPUTS = @outputs@ };

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 0);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) {
        return;
    }
    if (!ssSetNumInputPorts(S, 1) || !ssSetNumOutputPorts(S, 1)) {
        return;
    }
    ssSetInputPortWidth(S, 0, INPUTS);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 0, 1);
    ssSetOutputPortWidth(S, 0, OUTPUTS);
    ssSetNumSampleTimes(S, 1);
    /* The state as a work vector: each block has its own, and Simulink saves it. */
    ssSetNumDWork(S, 1);
    ssSetDWorkWidth(S, 0, (int_T)sizeof(@fo@_state));
    ssSetDWorkDataType(S, 0, SS_UINT8);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, @step_time@);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_INITIALIZE_CONDITIONS
static void mdlInitializeConditions(SimStruct *S)
{
    @fo@_state state;
    @fo@_reset(&@prefix@_observer, &state);
    (void)memcpy(ssGetDWork(S, 0), &state, sizeof state);
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    const real_T *input = ssGetInputPortRealSignal(S, 0);
    real_T *output = ssGetOutputPortRealSignal(S, 0);
    const fo_real voltage[FO_N] = {(fo_real)input[0], (fo_real)input[1]};
    const fo_real current[FO_N] = {(fo_real)input[2], (fo_real)input[3]};
    @fo@_state state;
    @fo@_estimate estimate;
    const @fo@_estimate *e = &estimate;
    (void)tid;
    (void)memcpy(&state, ssGetDWork(S, 0), sizeof state);
    @fo@_step(&@prefix@_observer, &state, voltage, current, &estimate);
    (void)memcpy(ssGetDWork(S, 0), &state, sizeof state);
    const real_T values[OUTPUTS] = {
@values@
    };
    for (int k = 0; k < OUTPUTS; k++) {
        output[k] = values[k];
    }
}

static void mdlTerminate(SimStruct *S) { (void)S; }

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
