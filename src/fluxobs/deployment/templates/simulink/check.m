% Replays the record in a model with the S-function and compares every output. UNTESTED in MATLAB.
record = readmatrix(fullfile('test', 'record.csv'));
sample_time = @step_time@;
t = (0:size(record, 1) - 1)' * sample_time;
model = 'fluxobs_check';
new_system(model);
add_block('simulink/Sources/From Workspace', [model '/record'], ...
    'VariableName', 'fluxobs_input', 'SampleTime', num2str(sample_time), 'Interpolate', 'off');
add_block('simulink/User-Defined Functions/S-Function', [model '/observer'], ...
    'FunctionName', '@name@');
add_block('simulink/Sinks/To Workspace', [model '/found'], ...
    'VariableName', 'fluxobs_output', 'SaveFormat', 'Array');
add_line(model, 'record/1', 'observer/1');
add_line(model, 'observer/1', 'found/1');
set_param(model, 'Solver', 'FixedStepDiscrete', 'FixedStep', num2str(sample_time), ...
    'StopTime', num2str(t(end)));
assignin('base', 'fluxobs_input', [t, record(:, 1:4)]);
result = sim(model, 'ReturnWorkspaceOutputs', 'on');
close_system(model, 0);
found = result.get('fluxobs_output');
columns = size(record, 2) - 4;
equal = all(found(:, 1:columns) == record(:, 5:end), 2);
fprintf('%d of %d rows equal\n', sum(equal), numel(equal));
assert(all(equal))
