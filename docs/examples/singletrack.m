function state = singletrack(file, radius, seconds)
% P on a circle around the origin, in MATLAB, or in Octave with its package instrument-control:
%
%   state = singletrack('/run/singletrackd/control.sock.token', 1.0, 20)
%
% The daemon needs two keys: socket.tcp_port = 8766, with which it writes this file, and, for the
% simulated car only, supervisor.require_calibration = false. Restart it after the change.
%
% The connection holds the drive: the car also stops when the function fails, is interrupted, or
% hangs for 0.5 s. Returned is the last state.
if exist('OCTAVE_VERSION', 'builtin'), pkg('load', 'instrument-control'); end
speed = 0.3; gain = 1.0;                                     % m/s, 1/s
drive = connect(file);
send(drive, ['{"version":3,"command":"set-reference",' ...
             '"reference":{"kind":"external","setpoint_timeout_ms":200}}']);
heard = ''; answered = 0; begin = tic;
while answered < 2         % token and reference: a car that was ready before is not just after it
  if toc(begin) > 2, error('the daemon is silent'); end
  pause(0.002);
  [answers, heard] = receive(drive, heard);
  answered = answered + numel(answers);
  for answer = answers
    if isfield(answer{1}, 'error'), error('%s', answer{1}.error); end
  end
end
states = connect(file);
send(states, '{"version":3,"command":"watch","topics":["state"]}');
state = []; armed = false; seen = ''; begin = tic; newest = tic;
while toc(begin) < seconds
  [answers, heard] = receive(drive, heard);
  for answer = answers
    if isfield(answer{1}, 'rejected'), disp(answer{1}.error);
    elseif isfield(answer{1}, 'error'), error('%s', answer{1}.error);
    elseif isfield(answer{1}, 'ended'), error('stopped: %s', answer{1}.ended.reason);
    end
  end
  [lines, seen] = receive(states, seen);
  if toc(newest) > 1, error('the daemon is silent'); end
  if isempty(lines) || ~isfield(lines{end}, 'point_m'), pause(0.002); continue; end
  state = lines{end}; newest = tic;                          % only the newest counts
  if isempty(state.point_m), continue; end                   % no cameras
  % The controller: along the circle, and back to it.
  outwards = state.point_m(:) / norm(state.point_m);
  along = [-outwards(2); outwards(1)];
  velocity = speed * along + gain * (radius - norm(state.point_m)) * outwards;
  % As old as the state that it answers: one that is late is rejected.
  send(drive, sprintf(['{"version":3,"command":"setpoint","velocity_m_s":[%.6f,%.6f],' ...
                       '"time_ns":%.0f}'], velocity, state.time_ns));
  if armed
    send(drive, '{"version":3,"command":"hold"}');
  elseif strcmp(state.mode, 'ready')
    send(drive, '{"version":3,"command":"arm","attendance":"hold"}');
    armed = true;
  end
end
send(drive, '{"version":3,"command":"disarm"}');
while armed && ~any(cellfun(@(answer) isfield(answer, 'ended'), answers))
  if toc(begin) > seconds + 5, error('the daemon does not say that the car stands'); end
  pause(0.01);
  [answers, heard] = receive(drive, heard);
end
end

function connection = connect(file)
if ~exist(file, 'file')
  error('there is no %s: set socket.tcp_port and restart the daemon', file);
end
key = jsondecode(fileread(file));
connection = tcpclient(key.address, key.port);
send(connection, sprintf('{"version":3,"command":"token","token":"%s"}', key.token));
end

function send(connection, line)
write(connection, uint8([line char(10)]));
end

function [messages, rest] = receive(connection, rest)
% The lines that have come, decoded, and what has come of the next one.
messages = {};
count = connection.NumBytesAvailable;
if count > 0, rest = [rest char(read(connection, count))]; end
ends = find(rest == char(10));
if isempty(ends), return; end
messages = cellfun(@jsondecode, strsplit(rest(1:ends(end) - 1), char(10)), ...
                   'UniformOutput', false);
rest = rest(ends(end) + 1:end);
end
