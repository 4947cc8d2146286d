"""Drives the car by set-points, with plain Python.

python3 client.py SOCKET [SECONDS] [--uncalibrated]

For the simulated car give --uncalibrated, as to singletrack arm."""
import json
import socket
import sys
import threading
import time


class Client:
    """A connection to the daemon: one JSON object a line, in each direction.

    The path is that of the socket, or of the file with the token for its port."""

    def __init__(self, path):
        tcp = path.endswith(".token")
        self.socket = socket.socket(socket.AF_INET if tcp else socket.AF_UNIX)
        self.lines = self.socket.makefile("r")
        if tcp:
            with open(path) as file:
                key = json.load(file)
            # Otherwise seconds of old states are kept for a client that is slow.
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            self.socket.connect((key["address"], key["port"]))
            self.ask("token", token=key["token"])
        else:
            self.socket.connect(path)

    def send(self, command, **keys):
        line = json.dumps({"version": 3, "command": command, **keys})
        self.socket.sendall(line.encode() + b"\n")

    def read(self):
        answer = json.loads(self.lines.readline() or '{"error":"the daemon has closed the connection"}')
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer

    def ask(self, command, **keys):
        self.send(command, **keys)
        return self.read()


def main(path, seconds=10.0, uncalibrated=False):
    drive = Client(path)
    drive.ask("set-reference", reference={"kind": "external"})
    # Opened after that: the car is not ready just after a change.
    states, failures = Client(path), []
    states.ask("watch", topics=["state"])
    threading.Thread(target=listen, args=[drive, failures], daemon=True).start()
    begin, sequence, asked = time.monotonic(), 0, False
    while time.monotonic() < begin + seconds and not failures:
        state = states.read()
        if "missed" in state:
            continue
        # The controller: slow, and to the left.
        sequence += 1
        drive.send("setpoint", steering_rad=0.4, speed_m_s=0.3,
                   time_ns=time.monotonic_ns(), sequence=sequence)
        if not asked and state["mode"] == "ready":
            drive.send("arm", attendance="hold", uncalibrated=uncalibrated)
            asked = True
        if asked and sequence % 10 == 0:
            drive.send("hold")
    if failures:
        raise RuntimeError(failures[0])
    if state["mode"] != "driving":
        raise RuntimeError(f"the car does not drive: mode {state['mode']}, reason {state['reason']}")
    drive.send("disarm")
    print(json.dumps(state))


def listen(drive, failures):
    """Keeps the first error, or the reason for which the drive has ended."""
    try:
        while True:
            answer = drive.read()
            if "ended" in answer:
                raise RuntimeError(f"the drive has ended: {answer['ended']['reason']}")
    except (OSError, RuntimeError) as error:
        failures.append(str(error))


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--uncalibrated"]
    if not words:
        sys.exit(__doc__)
    try:
        main(words[0], *map(float, words[1:2]), uncalibrated="--uncalibrated" in sys.argv)
    except (OSError, RuntimeError) as error:
        sys.exit(f"client.py: {error}")
