% Compiles the S-function @name@ in this folder. UNTESTED in MATLAB.
sources = {@mex_sources@};
mex('@name@.c', sources{:}, '-DFO_SINGLE=0', 'CFLAGS=$CFLAGS -std=c99 -ffp-contract=off')
