/* A stand-in for the parts of Simulink's header that the exported S-function uses: a block with one
 * input port, one output port and one work vector, run by main.c. */
#pragma once
#include <stdint.h>
#include <stdlib.h>

typedef double real_T;
typedef int int_T;
enum { SS_UINT8 = 3 };
typedef struct {
    real_T in[64], out[64];
    int inputs, outputs, work_size, contiguous, feedthrough;
    double period;
    void *work;
} SimStruct;

#define ssSetNumSFcnParams(S, n) ((void)(S), (void)(n))
#define ssGetNumSFcnParams(S) ((void)(S), 0)
#define ssGetSFcnParamsCount(S) ((void)(S), 0)
#define ssSetNumInputPorts(S, n) ((void)(S), (n) == 1)
#define ssSetNumOutputPorts(S, n) ((void)(S), (n) == 1)
#define ssSetInputPortWidth(S, p, n) ((void)(p), (S)->inputs = (n))
#define ssSetOutputPortWidth(S, p, n) ((void)(p), (S)->outputs = (n))
#define ssSetInputPortRequiredContiguous(S, p, n) ((void)(p), (S)->contiguous = (n))
#define ssSetInputPortDirectFeedThrough(S, p, n) ((void)(p), (S)->feedthrough = (n))
#define ssSetNumSampleTimes(S, n) ((void)(S), (void)(n))
#define ssSetSampleTime(S, k, h) ((void)(k), (S)->period = (h))
#define ssSetOffsetTime(S, k, h) ((void)(S), (void)(k), (void)(h))
#define ssSetNumDWork(S, n) ((void)(S), (void)(n))
#define ssSetDWorkWidth(S, k, n) ((void)(k), (S)->work_size = (n))
#define ssSetDWorkDataType(S, k, t) ((void)(S), (void)(k), (void)(t))
#define ssGetDWork(S, k) ((void)(k), (S)->work)
#define ssGetInputPortRealSignal(S, p) ((void)(p), (S)->in)
#define ssGetOutputPortRealSignal(S, p) ((void)(p), (S)->out)
