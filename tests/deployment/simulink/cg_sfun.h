/* Runs the S-function that includes it: rows of four doubles from standard input, rows of its outputs
 * on standard output. */
#include <stdio.h>

int main(void)
{
    static SimStruct block;
    double row[4];
    mdlInitializeSizes(&block);
    mdlInitializeSampleTimes(&block);
    if (block.inputs != 4 || !block.contiguous || !block.feedthrough || !(block.period > 0)) {
        return 1;
    }
    block.work = malloc((size_t)block.work_size);
    mdlInitializeConditions(&block);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        for (int k = 0; k < 4; k++) {
            block.in[k] = row[k];
        }
        mdlOutputs(&block, 0);
        if (fwrite(block.out, sizeof(double), (size_t)block.outputs, stdout) == 0) {
            return 1;
        }
    }
    mdlTerminate(&block);
    free(block.work);
    return 0;
}
