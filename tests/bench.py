"""`make bench`: latency, load, memory, start-up and simulator speed, as ratios and figures of one
run on this machine.

`python -m tests.bench [--write] PART...` measures single parts, such as ``simulator``,
``long_flights`` or ``campaigns``; all without a name. ``--write`` puts the figures into the README
(`tests.bench_page`).

Nothing here is asserted: machines are noisy. The figures that the project aims for stand beside the
measured ones.
"""

import cProfile
import os
import re
import resource
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from companion.jit import cache_directory
from companion.jobs import executor_of
from companion.mavlink.codec import Decoder, Encoder, Message, mavlink
from companion.settings import CompanionSettings
from sim import STEPS_PER_TICK, TICK_US
from sim.flight import Flight
from sim.scenario import Scenario, load_scenario
from sim.studies import campaign
from tests import bench_page
from tests.bench_page import Row
from tests.long_flights import long_flight

PRESSURE_HZ = 50
MIX_HZ = {"pressure": 100, "gnss": 10, "attitude": 90, "imu": 200}
"""400 messages a second, as a busy companion port carries"""
ECHO = """
import socket, sys
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(("127.0.0.1", int(sys.argv[1])))
print("ready", flush=True)
while True:
    data, peer = s.recvfrom(2048)
    s.sendto(data.ljust(int(sys.argv[2])), peer)
"""

READER = """
import http.client, sys
connection = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1]))
connection.request("GET", "/api/events")
events = connection.getresponse()
print("ready", flush=True)
while events.readline():
    pass
"""
PAGES = 3


def main() -> None:
    parts = (
        start_up,
        latency,
        live_page,
        load_and_memory,
        simulator,
        long_flights,
        campaigns,
        estimators,
        logs,
        batches,
        papers,
    )
    named = [name for name in sys.argv[1:] if name != "--write"]
    known = {part.__name__: part for part in parts}
    if unknown := set(named) - set(known):
        sys.exit(f"no part is called {', '.join(sorted(unknown))}; there are: {', '.join(known)}")
    rows: list[Row] = []
    for name in named or known:
        print(f"measuring: {name.replace('_', ' ')} ...", file=sys.stderr, flush=True)
        found = known[name]()
        rows += found
        if "--write" in sys.argv:
            bench_page.keep(name, found)
            bench_page.write_readme()
    print(bench_page.table(rows), end="")


# The companion as a process


@contextmanager
def process(
    command: list[str], environment: dict[str, str] | None = None
) -> Iterator["subprocess.Popen[str]"]:
    """A child that has said "ready"; ended with SIGTERM, as a shell's background job ignores SIGINT
    and so do its children."""
    child = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | (environment or {}),
    )
    assert child.stdout is not None
    try:
        for line in child.stdout:
            if line.startswith("ready"):
                break
        yield child
    finally:
        child.send_signal(signal.SIGTERM)
        child.wait(20)
        child.stdout.close()


def companion(port: int, *options: str) -> list[str]:
    return [sys.executable, "-m", "companion.cli", "run", f"udpin:127.0.0.1:{port}", *options]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def heartbeat() -> Message:
    return mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)


def pressure(boot_ms: int) -> Message:
    return mavlink.MAVLink_scaled_pressure_message(boot_ms, 954.61 + 0.01 * (boot_ms % 7), 0, 2500)


def gnss(boot_ms: int) -> Message:
    return mavlink.MAVLink_gps_raw_int_message(
        boot_ms * 1000,
        3,
        470000000,
        80000000,
        500_000 + boot_ms % 900,
        100,
        150,
        0,
        0,
        10,
        0,
        1000,
        2000,
        0,
        0,
    )


def attitude(boot_ms: int) -> Message:
    return mavlink.MAVLink_attitude_message(boot_ms, 0.01, 0.02, 0.03, 0.0, 0.0, 0.0)


def imu(boot_ms: int) -> Message:
    return mavlink.MAVLink_raw_imu_message(boot_ms * 1000, 3, 4, -1000, 1, 2, 3, 200, 10, 400)


# Latency


def latency() -> list[Row]:
    """From the last byte of a SCALED_PRESSURE to our ALTITUDE, against an echo process with frames
    of the same size."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bench.yaml"
        config.write_text(
            f"publish: {{altitude_hz: {PRESSURE_HZ}, debug: false}}\nstreams: {{request: false}}\n"
        )
        port = free_port()
        with process(companion(port, "--config", str(config))):
            ours_ms = round_trips(port, answer=altitude_in)
        port = free_port()
        with process([sys.executable, "-c", ECHO, str(port), "44"]):
            floor_ms = round_trips(port, answer=lambda data: True)
    ours, floor = np.percentile(ours_ms, (50, 99)), np.percentile(floor_ms, (50, 99))
    return [
        ("SCALED_PRESSURE in to ALTITUDE out, p50", f"{ours[0]:.3f} ms", "0.3 ms"),
        ("the same, p99", f"{ours[1]:.3f} ms", "2 ms"),
        (
            "UDP echo process of the same size, p50 / p99 (the floor)",
            f"{floor[0]:.3f} / {floor[1]:.3f} ms",
            "",
        ),
        (
            "p50 over that of a UDP echo of the same size",
            f"{ours[0] / floor[0]:.1f} times",
            "2.5 times",
        ),
    ]


def live_page() -> list[Row]:
    """The latency with and without the live page and `PAGES` readers of it."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bench.yaml"
        config.write_text(
            f"publish: {{altitude_hz: {PRESSURE_HZ}, debug: false}}\nstreams: {{request: false}}\n"
        )
        taken = []
        for pages in (0, PAGES):
            port, http = free_port(), free_port()
            options = ["--http", str(http)] if pages else []
            with ExitStack() as stack:
                stack.enter_context(process(companion(port, "--config", str(config), *options)))
                for _ in range(pages):
                    stack.enter_context(process([sys.executable, "-c", READER, str(http)]))
                taken.append(np.percentile(round_trips(port, answer=altitude_in), (50, 99)))
    (p50, p99), (with_p50, with_p99) = taken
    return [
        ("without the live page, p50 / p99", f"{p50:.3f} / {p99:.3f} ms", ""),
        (f"with {PAGES} open pages, p50 / p99", f"{with_p50:.3f} / {with_p99:.3f} ms", "the same"),
    ]


def altitude_in(data: bytes) -> bool:
    return any(
        frame.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE for frame in Decoder().feed(data)
    )


def round_trips(port: int, answer: Callable[[bytes], bool], count: int = 1500) -> list[float]:
    """Milliseconds from sending a pressure to the answer, at the pressure's rate in real time."""
    vehicle, taken = Encoder(1, 1), []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.connect(("127.0.0.1", port))
        udp.settimeout(0.2)
        for index in range(count):
            boot_ms = 10_000 + index * 1000 // PRESSURE_HZ
            if index % PRESSURE_HZ == 0:
                udp.send(vehicle.encode(heartbeat()))
            if index % 10 == 0:
                udp.send(vehicle.encode(gnss(boot_ms - 120)))
            time.sleep(1 / PRESSURE_HZ)
            drain(udp)
            data = vehicle.encode(pressure(boot_ms))
            sent_s = time.perf_counter()
            udp.send(data)
            try:
                is_answer = False
                while not is_answer:
                    received = udp.recv(2048)
                    received_s = time.perf_counter()
                    is_answer = answer(received)
            except TimeoutError:
                continue  # before the first altitude there is no answer
            taken.append(1e3 * (received_s - sent_s))
    return taken[len(taken) // 10 :]


def drain(udp: socket.socket) -> None:
    """Forget what came in meanwhile."""
    with selectors.DefaultSelector() as selector:
        selector.register(udp, selectors.EVENT_READ)
        while selector.select(0):
            udp.recv(2048)


# Load and memory


def load_and_memory(load_s: int = 15, hour_s: int = 3600) -> list[Row]:
    """CPU at 400 messages a second in real time; memory after that, after an hour's messages, and
    after compiling."""
    with tempfile.TemporaryDirectory() as cache:
        port = free_port()
        with process(companion(port), {"KOLLSMAN_CACHE": cache}) as child:
            cold_mb = resident_mb(child.pid)
        port = free_port()
        with process(companion(port), {"KOLLSMAN_CACHE": cache}) as child, sender(port) as send:
            started_s, cpu_s = time.perf_counter(), cpu_time_s(child.pid)
            boot_ms = 10_000
            while time.perf_counter() - started_s < load_s:
                send(boot_ms)
                boot_ms += 10
                time.sleep(max(0.0, started_s + (boot_ms - 10_000) * 1e-3 - time.perf_counter()))
            share = (cpu_time_s(child.pid) - cpu_s) / (time.perf_counter() - started_s)
            warm_mb = resident_mb(child.pid)
            until_ms = boot_ms + hour_s * 1000
            while boot_ms < until_ms:
                send(boot_ms)
                boot_ms += 10
                if boot_ms % 1000 == 0:
                    time.sleep(0.015)  # about 25,000 messages a second, which it can follow
            time.sleep(1.0)
            hour_mb = resident_mb(child.pid)
    return [
        ("load of one core at 400 messages/s", f"{100 * share:.1f} %", "3 %"),
        ("resident after compiling", f"{cold_mb:.0f} MB", "250 MB"),
        ("resident from a warm cache, under load", f"{warm_mb:.0f} MB", "200 MB"),
        ("resident after another hour's messages (1.44 million)", f"{hour_mb:.0f} MB", "no growth"),
    ]


@contextmanager
def sender(port: int) -> Iterator[Callable[[int], None]]:
    """A vehicle that sends what is due in ten milliseconds of `MIX_HZ`, each message a datagram."""
    makers = {"pressure": pressure, "gnss": gnss, "attitude": attitude, "imu": imu}
    vehicle = Encoder(1, 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.connect(("127.0.0.1", port))
        udp.setblocking(False)

        def send(boot_ms: int) -> None:
            if boot_ms % 1000 == 0:
                udp.send(vehicle.encode(heartbeat()))
            for name, rate_hz in MIX_HZ.items():
                for due in range(boot_ms * rate_hz // 1000, (boot_ms + 10) * rate_hz // 1000):
                    udp.send(vehicle.encode(makers[name](due * 1000 // rate_hz)))
            try:
                while udp.recv(2048):
                    pass
            except BlockingIOError:
                pass

        yield send


def cpu_time_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


# Start-up, simulator, estimators


def start_up() -> list[Row]:
    """Best of five, with everything in the file cache."""
    script = Path(sys.executable).with_name("kollsman")
    show_help = partial(subprocess.run, [script, "--help"], stdout=subprocess.DEVNULL, check=True)
    help_s = min(timed(show_help) for _ in range(5))
    warm_up()

    def start() -> None:
        with process(companion(free_port())):
            started.append(time.perf_counter())

    started: list[float] = []
    ready_s = []
    for _ in range(5):
        before_s = time.perf_counter()
        start()
        ready_s.append(started[-1] - before_s)
    return [
        ("`kollsman --help`", f"{help_s:.2f} s", "0.3 s"),
        ("`kollsman run` until ready, compiled code cached", f"{min(ready_s):.2f} s", "2 s"),
    ]


def warm_up() -> None:
    """Compile the estimators, unless the cache has them."""
    script = Path(sys.executable).with_name("kollsman")
    subprocess.run(
        [script, "warm-up"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True
    )


def timed(action: Callable[[], object]) -> float:
    before_s = time.perf_counter()
    action()
    return time.perf_counter() - before_s


def simulator() -> list[Row]:
    """Flights to a log against bare stepping of the same aircraft for as long, by processor time;
    medians of three.

    Bare is JSBSim with the six properties that an IMU needs, from where the flight begins."""
    calm = load_scenario("calm-circuit")
    faults = (*load_scenario("failing-barometer").faults, *load_scenario("lossy-radio").faults)
    stacked = load_scenario("inversion-approach").model_copy(update={"faults": faults})
    rows: list[Row] = []
    for what, scenario, aim in (
        ("50 Hz IMU, all messages, to a tlog", calm, "150 times"),
        ("the same of the 737", load_scenario("airliner-descent"), "150 times"),
        ("the same of the F-16", load_scenario("fighter-low-level"), "150 times"),
        ("the same of the glider", load_scenario("glider-spiral"), "150 times"),
        (f"the same with {len(faults)} faults at once and a layered atmosphere", stacked, ""),
    ):
        faster, shares = [], []
        for _ in range(3):
            flight, flown_s, _ = flown(scenario)
            bare = Flight(scenario)
            bare_s = cpu_of(partial(bare.aircraft.advance, 5000 * STEPS_PER_TICK)) / 5000
            faster.append(flight.time_us * 1e-6 / flown_s)
            shares.append(bare_s * (flight.time_us // TICK_US) / flown_s)
        rows += [
            (
                f"{flight.time_us / 60e6:.0f}-minute flight, {what}",
                f"{median(faster):.0f} times real time",
                aim,
            ),
            (
                "JSBSim's bare stepping in that",
                f"{100 * median(shares):.0f} %",
                "50 %" if aim else "",
            ),
        ]
    return rows + where_time_goes(calm)


def long_flights() -> list[Row]:
    """Hours at cruise through weather, to a log."""
    rows: list[Row] = []
    for what, scenario in (
        ("`hour-long-cruise`, c172p at 2000 m", load_scenario("hour-long-cruise")),
        ("4 h of a 737 at 11 km through a front", long_flight("737", 11_000.0, 4.0)),
        (
            "3 h of an F-16 at 6 km through a front, endless fuel",
            long_flight("f16", 6000.0, 3.0, endless_fuel=True),
        ),
    ):
        flight, used_s, _ = flown(scenario)
        rows.append(
            (
                what,
                f"{used_s:.0f} s CPU, {flight.time_us * 1e-6 / used_s:.0f} times real time",
                "minutes",
            )
        )
    return rows


def flown(
    scenario: Scenario, profiler: cProfile.Profile | None = None
) -> tuple[Flight, float, float]:
    """A flight to a log that is thrown away, its processor time and its time by the clock (s)."""
    with tempfile.TemporaryDirectory() as folder:
        flight = Flight(scenario, tlog=Path(folder) / "bench.tlog")
        started_s = time.perf_counter()
        used_s = cpu_of(partial(profiler.runcall, flight.run) if profiler else flight.run)
        return flight, used_s, time.perf_counter() - started_s


def cpu_of(action: Callable[[], object]) -> float:
    """Processor time of this process (s)."""
    before_s = time.process_time()
    action()
    return time.process_time() - before_s


PARTS = {
    "sim/aircraft.py": "JSBSim and its properties", "sim/sensors": "sensors",
    "sim/pilot": "autopilot, profile", "sim/vehicle/ardupilot.py": "payloads of messages",
    "sim/vehicle/ports.py": "rates, frames", "sim/vehicle/frames.py": "rates, frames",
    "sim/vehicle/vehicle.py": "vehicle", "sim/vehicle/own_estimate.py": "vehicle",
    "companion/logs": "log", "sim/flight.py": "the loop", "sim/weather": "weather",
}  # fmt: skip


def where_time_goes(scenario: Scenario) -> list[Row]:
    """Shares of a flight under the profiler, which makes small functions dearer; builtins count to
    their callers."""
    profiler = cProfile.Profile(builtins=False)
    flown(scenario, profiler)
    shares: dict[str, float] = {}
    for entry in profiler.getstats():
        path = entry.code if isinstance(entry.code, str) else entry.code.co_filename
        part = next((part for place, part in PARTS.items() if place in path), "rest")
        shares[part] = shares.get(part, 0.0) + entry.inlinetime
    whole = sum(shares.values())
    found = ", ".join(
        f"{part} {100 * share / whole:.0f} %"
        for part, share in sorted(shares.items(), key=lambda item: -item[1])
    )
    return [("where that flight's time goes, under the profiler", found, "")]


def campaigns(flights: int = 8) -> list[Row]:
    """The same flights by one worker and by two: by the clock, and what a second process costs in
    processor time."""
    jobs = campaign.jobs_of(["calm-circuit"], flights, ["vertical-bank", "adaptive-fusion"])

    def fly(workers: int) -> None:
        with tempfile.TemporaryDirectory() as folder, executor_of(workers, None) as executor:
            campaign.run(jobs, executor, Path(folder))

    return by_workers(f"{flights} flights of 21 minutes and two estimators", fly, "2")


def by_workers(what: str, action: Callable[[int], object], aim: str) -> list[Row]:
    """An action by one worker and by two: by the clock and in processor time of the workers, and
    what this process does meanwhile, which no further worker makes faster."""
    warm_up()  # or the first to run would compile
    taken = []
    load = os.getloadavg()[0]
    for workers in (1, 2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        started_s, own_s = time.perf_counter(), time.process_time()
        action(workers)
        wall_s, own_s = time.perf_counter() - started_s, time.process_time() - own_s
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        taken.append((wall_s, cpu_s, own_s))
    (one_s, one_cpu_s, one_own_s), (two_s, two_cpu_s, two_own_s) = taken
    text = "{:.1f} s, {:.1f} s CPU, {:.1f} s of the process that gives the work"
    return [
        (f"{what}, one worker", text.format(one_s, one_cpu_s, one_own_s), ""),
        ("the same, two workers", text.format(two_s, two_cpu_s, two_own_s), ""),
        (
            f"{what}, two workers: speed-up by the clock / were both cores ours",
            f"{one_s / two_s:.2f} / {2 * one_cpu_s / two_cpu_s:.2f}",
            aim,
        ),
        (
            "load of the machine in the minute before and the last",
            f"{load:.1f} / {os.getloadavg()[0]:.1f}",
            "",
        ),
    ]


def estimators() -> list[Row]:
    """Cost of a sample in the compiled loop, over a simulated flight."""
    from companion.estimators import ESTIMATORS, run_log
    from companion.evaluation.samples import samples_of

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.tlog"
        Flight(load_scenario("short-hop"), tlog=path).run()
        log = samples_of(path)
    rows: list[Row] = []
    for name, method in ESTIMATORS.items():
        run_log(method, log)
        best_s = min(timed(partial(run_log, method, log)) for _ in range(5))
        rows.append(
            (f"`{name}`, a sample in the compiled loop", f"{1e6 * best_s / len(log):.2f} us", "")
        )
    return rows


def papers() -> list[Row]:
    """Paper H, section 5: processor time of the adaptive filter over that of the fixed one, on the
    paper's descent under drift; median of 15 pairs."""
    from sim.studies.page import generators
    from sim.studies.papers.adaptive_fusion import simulation as paper_h

    rows = paper_h.VehicleRows()
    noise = generators("H", 1)[0].standard_normal((2, paper_h.PRESSURE_KPA.size))
    baro_m = paper_h.DRIFT.baro_m + paper_h.R_B**0.5 * noise[0]
    rows.fill(baro_m, paper_h.DRIFT.truth_m + paper_h.R_GPS**0.5 * noise[1])

    def fifty(gain: paper_h.Gain) -> None:
        for _ in range(50):
            rows.estimates(gain)

    rows.estimates("fixed")
    ratios = [
        cpu_of(partial(fifty, "adaptive")) / cpu_of(partial(fifty, "fixed")) for _ in range(15)
    ]
    return [
        ("paper H: adaptive over fixed filter, processor time", f"{median(ratios):.2f}", "1.14")
    ]


def logs() -> list[Row]:
    """Reading logs, on one simulated flight repeated to 50 MB, and replaying one of 21 minutes; by
    processor time, which other programs do not change."""
    import struct

    from pymavlink import mavutil

    from companion.logs import dataflash
    from companion.logs.tlog import TlogReader
    from companion.pipeline import Pipeline
    from companion.replay.run import replay
    from tests import logfiles

    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        hop, large = Path(folder) / "hop.tlog", Path(folder) / "large.tlog"
        Flight(load_scenario("short-hop"), tlog=hop).run()
        packets = list(TlogReader(hop))
        once = b"".join(struct.pack(">Q", time) + data for time, data in packets)
        large.write_bytes(once * (50_000_000 // len(once) + 1))
        reader = TlogReader(large)
        scan_s = min(spent(lambda: sum(batch.size for batch in reader.batches())) for _ in (1, 2))
        frames = len(packets) * (large.stat().st_size // len(once))
        wanted = Pipeline(CompanionSettings(), datagrams=True).wanted
        items_s = spent(lambda: sum(1 for _ in reader.items(wanted)))
        circuit = Path(folder) / "circuit.tlog"
        flown_s = Flight(load_scenario("calm-circuit"), tlog=circuit).run().duration_s
        decode_s = spent(lambda: read_all(mavutil.mavlink_connection(str(circuit))))
        cheap = CompanionSettings(estimator="adaptive-fusion")
        replay(hop)  # what is compiled is loaded
        replay(hop, cheap)
        replay_s, cheap_s = spent(lambda: replay(circuit)), spent(lambda: replay(circuit, cheap))
        flown = sum(1 for _ in TlogReader(circuit))
        theirs, ours = flown / decode_s, frames / scan_s
        mb_s = large.stat().st_size * 1e-6 / scan_s
        scan = f"{ours * 1e-6:.1f} million/s, {mb_s:.0f} MB/s"
        rows.append(
            ("tlog scan with checksums", f"{scan}, {ours / theirs:.0f} x pymavlink", "100 x")
        )
        rows += fast_parser(large, frames, ours) + replay_memory(hop)
        rows.append(("tlog frames with decoded messages", f"{frames / items_s / theirs:.0f} x", ""))
        rows += replay_rows("vertical-bank", flown_s, replay_s, decode_s)
        rows += replay_rows("adaptive-fusion", flown_s, cheap_s, decode_s)
        path, _ = logfiles.write("bin", Path(folder), imu_hz=400.0)
        data = np.frombuffer(path.read_bytes() * 8, np.uint8)
        dataflash._index(data)
        rate = data.size * 1e-6 / spent(lambda: dataflash._index(data))
        rows.append(("dataflash .bin scan", f"{rate:.0f} MB/s", "200 MB/s"))
    return rows


def replay_rows(estimator: str, flown_s: float, replay_s: float, decode_s: float) -> list[Row]:
    """A replay without the start of the process, its code in the cache, beside the flight and
    pymavlink's decoding of the same log."""
    name = f"replay of a 50 Hz log, `{estimator}`"
    ratio = f"{replay_s / decode_s:.2f} x pymavlink's decoding alone"
    return [
        (name, f"{flown_s / replay_s:.0f} x real time", "10,000 x"),
        (f"{name}, processor time", ratio, "1 x"),
    ]


def fast_parser(large: Path, frames: int, ours: float) -> list[Row]:
    """The fastest C++ package on the same file, built in an environment of its own."""
    name, aim = "the same, fasttlogparser (C++)", "ours >= 5 x"
    python = environment_of("fasttlogparser", BUILD_TOOLS)
    if python is None:
        return [(name, "does not build here", aim)]
    script = (
        "import sys, time, fasttlogparser; start = time.process_time(); "
        "fasttlogparser.parseTLog(sys.argv[1]); print(time.process_time() - start)"
    )
    theirs = frames / float(subprocess.check_output([python, "-c", script, large], text=True))
    return [(name, f"{theirs * 1e-6:.2f} million/s; ours {ours / theirs:.1f} x", aim)]


BUILD_TOOLS = ("scikit-build-core", "nanobind", "pybind11", "cmake", "ninja", "setuptools", "numpy")


def environment_of(package: str, build_tools: Sequence[str]) -> Path | None:
    """The Python of an environment with a package that is built from its source; None when that
    fails. It is kept in the user's cache folder."""
    folder = cache_directory() / f"bench-{package}"
    python = folder / "bin" / "python"

    def works(*command: str | Path) -> bool:
        quiet = subprocess.DEVNULL
        return subprocess.run(command, check=False, stdout=quiet, stderr=quiet).returncode == 0

    is_there = python.exists() and works(python, "-c", f"import {package}")
    pip = (python, "-m", "pip", "install", "-q")
    built = is_there or (
        works(sys.executable, "-m", "venv", folder)
        and works(*pip, *build_tools)
        and works(*pip, "--no-build-isolation", package)
        and works(python, "-c", f"import {package}")
    )
    return python if built else None


def replay_memory(small: Path) -> list[Row]:
    """Growth of the largest resident set of a process with the size of the log that it replays: the
    straight line through logs of three sizes, each replayed by a process of its own."""
    script = (
        "import sys, resource; from pathlib import Path; from companion.replay.run import replay; "
        "replay(Path(sys.argv[1])); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    once, sizes_mb, peaks_mb = small.read_bytes(), [], []
    for size in (20e6, 60e6, 120e6):
        path = small.with_name("grown.tlog")
        path.write_bytes(once * round(size / len(once)))
        printed = subprocess.check_output([sys.executable, "-c", script, str(path)], text=True)
        sizes_mb.append(path.stat().st_size / 2**20)
        peaks_mb.append(int(printed.split()[-1]) / 1024)
    grown, constant_mb = np.polyfit(sizes_mb, peaks_mb, 1)
    pairs = zip(peaks_mb, sizes_mb, strict=True)
    each = ", ".join(f"{peak_mb:.0f} MB for {size_mb:.0f} MB" for peak_mb, size_mb in pairs)
    text = f"{grown:.1f} x the file plus {constant_mb:.0f} MB ({each})"
    return [("memory of a replay", text, "3 x the file plus a constant")]


def batches(count: int = 200) -> list[Row]:
    """A folder of `count` logs of five minutes each, by one worker and by two."""
    from companion.replay.batch import run_batch

    with tempfile.TemporaryDirectory() as folder:
        profile = [{"leg": "wait", "duration_s": 300.0}]
        scenario = Scenario.model_validate(
            {"name": "stand", "summary": "of the benchmark", "profile": profile}
        )
        paths = [Path(folder) / f"{k}.tlog" for k in range(count)]
        Flight(scenario, tlog=paths[0]).run()
        for path in paths[1:]:
            os.link(paths[0], path)

        def work(workers: int) -> None:
            table = run_batch(paths, Path(folder) / f"by{workers}", workers=workers)
            assert len(table) == count
            assert all(row["error"] is None for row in table)

        return by_workers(f"batch of {count} logs of 5 minutes", work, "1.8 x")


def spent(action: Callable[[], object]) -> float:
    """Processor time of an action."""
    before_s = time.process_time()
    action()
    return time.process_time() - before_s


def read_all(log: Any) -> None:
    """Decode every message of a pymavlink log."""
    while log.recv_msg() is not None:
        pass
    log.close()


if __name__ == "__main__":
    main()
