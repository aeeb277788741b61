"""An episode through Python's traci, for `cross bench traci`, which starts this program and explains the conversation.

Without arguments it says what it is. With the file of a job and one to write to, it drives an episode.
"""

import json
import platform
import sys
import time

import traci
from traci import constants

VALUES = (constants.VAR_LANE_ID, constants.VAR_LANEPOSITION, constants.VAR_SPEED)
# As long as a SUMO that starts on a busy machine may take.
PATIENCE = 60.0


def connect(port):
    """Connects as soon as SUMO listens; traci's own repetition would wait for a second in between."""
    begun = time.monotonic()
    while True:
        try:
            return traci.init(port, numRetries=0, host="127.0.0.1")
        except traci.exceptions.FatalTraCIError:
            if time.monotonic() - begun > PATIENCE:
                raise
            time.sleep(0.005)


def subscribe(job, *between):
    traci.junction.subscribeContext(job["anchor"], constants.CMD_GET_VEHICLE_VARIABLE, job["range"], VALUES, *between)


def show(states):
    for light, state in states:
        traci.trafficlight.setRedYellowGreenState(light, state)


def poll():
    """Position, speed and lane of every vehicle, by getters."""
    vehicle = traci.vehicle
    return [
        (vehicle.getLanePosition(name), vehicle.getSpeed(name), vehicle.getLaneID(name)) for name in vehicle.getIDList()
    ]


def subscribed(anchor):
    """The same, from what the last step brought."""
    lane, position, speed = VALUES
    found = traci.junction.getContextSubscriptionResults(anchor)
    return [(values[position], values[speed], values[lane]) for values in found.values()]


def episode(job):
    """What was seen at each decision."""
    way = job["way"]
    by_second = way in ("polling", "every-second")
    now = job["begin"]
    seen = []
    show(job["first"])
    if way in ("every-second", "every-decision"):
        subscribe(job)
    for legs in job["decisions"]:
        for leg in legs:
            show(leg["show"])
            now += leg["seconds"]
            if by_second:
                for _ in range(leg["seconds"]):
                    traci.simulationStep()
            else:
                if way == "momentary" and leg is legs[-1]:
                    subscribe(job, now, now)
                traci.simulationStep(now)
        seen.append(poll() if way == "polling" else subscribed(job["anchor"]))
    traci.close()
    return seen


def main():
    if len(sys.argv) != 3:
        print(f"traci in Python {platform.python_version()}, TraCI {constants.TRACI_VERSION}")
        return
    with open(sys.argv[1], encoding="utf-8") as file:
        job = json.load(file)
    print("ready", flush=True)
    port = int(sys.stdin.readline())
    begun = time.process_time()
    connect(port)
    seen = episode(job)
    print("cpu", time.process_time() - begun, flush=True)
    sys.stdin.read()
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        for vehicles in seen:
            print(len(vehicles), file=file)
            for position, speed, lane in vehicles:
                print(repr(position), repr(speed), lane, file=file)


if __name__ == "__main__":
    main()
