// Firmware of a manifold on a Teensy 4.x. docs/reference/rig_protocol.md defines the protocol; `CHAMBERS` in messages.h
// is the number of chambers. Before you flash the firmware, read rig/firmware/README.md on pins, valves without
// current, and calibration.

#include <Watchdog_t4.h>  // comes with Teensyduino

#include <iterator>

#include "manifold_core.h"
#include "valves.h"

using namespace slider;

// ---- The link ------------------------------------------------------------------------------------------------
#define LINK Serial  // USB, which ignores the baud rate; Serial1 for a UART
constexpr uint32_t BAUD = 2000000;

// ---- Pins: front left, front right, rear left, rear right ---------------------------------------------------
constexpr uint8_t FILL_PINS[] = {2, 3, 4, 5};
constexpr uint8_t VENT_PINS[] = {6, 7, 8, 9};
constexpr uint8_t PRESSURE_PINS[] = {14, 15, 16, 17};  // A0 to A3
constexpr uint8_t SUPPLY_PIN = 18;                             // A4
constexpr uint8_t INPUT_PINS[3] = {19, 20, 21};                // A5 to A7
// True if the vent valves are open without current. Such valves are safer (see rig/firmware/README.md).
constexpr bool VENT_OPEN_WITHOUT_CURRENT = false;

// ---- Calibration: twelve-bit counts to gauge pascals, Pa = slope (count - zero) ----------------------------
// The preset is the published rig's sensor: psi = 0.13529 count - 12.4282 with ten bits. Measure your own sensors.
struct Line {
    float slope, zero;
};
constexpr Line CHAMBER_LINES[] = {
    {233.2f, 367.5f}, {233.2f, 367.5f}, {233.2f, 367.5f}, {233.2f, 367.5f}};
constexpr Line SUPPLY_LINE = {233.2f, 367.5f};
constexpr float UV_PER_COUNT = 3.3e6f / 4096;
// A sensor outside these counts is broken or unplugged. The reading is then BROKEN_Pa, which is above any limit, so
// the manifold vents. Otherwise a sensor that reads zero would keep the chamber's fill valve open.
constexpr int LEAST_COUNT = 120, MOST_COUNT = 4050;
constexpr int32_t BROKEN_Pa = 10000000;

// The compiler would fill a missing entry with zeros, and such a sensor would keep its fill valve open.
static_assert(std::size(FILL_PINS) == CHAMBERS && std::size(VENT_PINS) == CHAMBERS &&
                  std::size(PRESSURE_PINS) == CHAMBERS && std::size(CHAMBER_LINES) == CHAMBERS,
              "give one entry for each chamber");

// ---- Content of Ident ---------------------------------------------------------------------------------------
// Set the hard limits to the pressures that your chambers withstand. The published tests reached 372 kPa.
constexpr uint16_t LONGEST = 2000;
constexpr Settings SETTINGS = {PROTOCOL, {1, 1, 0}, LONGEST, 500, {400000, 400000, 400000, 400000}};

static_assert(SETTINGS.hard_limits[CHAMBERS - 1] > 0, "give one hard limit for each chamber");

// If the loop hangs for this time [ms], the hardware watchdog resets the board, which vents.
constexpr double WATCHDOG_MS = 50;

static Sample wave[LONGEST];
static Ring out;
static ManifoldCore core(SETTINGS, wave, out);
static WDT_T4<WDT3> watchdog;

static void drive(size_t chamber, Duty duty) {
    analogWrite(FILL_PINS[chamber], duty.fill);
    analogWrite(VENT_PINS[chamber], VENT_OPEN_WITHOUT_CURRENT ? 255 - duty.vent : duty.vent);
}

static void drive_all(const int32_t (&channels)[CHANNELS]) {
    const int32_t* set = core.set_pressures();
    for (size_t i = 0; i < CHAMBERS; ++i) drive(i, set ? law(set[i], channels[i]) : VENTING);
}

static int32_t pascals(uint8_t pin, Line line) {
    const int count = analogRead(pin);
    if (count < LEAST_COUNT || count > MOST_COUNT) return BROKEN_Pa;
    return static_cast<int32_t>(line.slope * (static_cast<float>(count) - line.zero));
}

static void read_all(int32_t (&channels)[CHANNELS]) {
    for (size_t i = 0; i < CHAMBERS; ++i) channels[i] = pascals(PRESSURE_PINS[i], CHAMBER_LINES[i]);
    channels[CHAMBERS] = pascals(SUPPLY_PIN, SUPPLY_LINE);
    for (size_t i = 0; i < 3; ++i)
        channels[CHAMBERS + 1 + i] =
            static_cast<int32_t>(UV_PER_COUNT * static_cast<float>(analogRead(INPUT_PINS[i])));
}

// Microseconds since the start; `micros()` alone restarts every 71 minutes.
static uint64_t now_us() {
    static uint64_t now = 0;
    now += static_cast<uint32_t>(micros() - static_cast<uint32_t>(now));
    return now;
}

// Takes the available bytes, at most 256 per loop, because the host may send without end or stop within a frame.
static void receive() {
    uint8_t bytes[256];
    size_t size = 0;
    while (size < sizeof bytes && LINK.available() > 0) bytes[size++] = static_cast<uint8_t>(LINK.read());
    core.feed(bytes, size, now_us());
}

// Sends only the bytes that the link accepts without waiting, because a wait would stop the valve control.
static void transmit() {
    const int room = LINK.availableForWrite();
    if (room <= 0) return;
    const size_t size = out.contiguous() < static_cast<size_t>(room) ? out.contiguous() : static_cast<size_t>(room);
    if (size > 0) out.drop(LINK.write(out.front(), size));
}

void setup() {
    for (size_t i = 0; i < CHAMBERS; ++i) {
        pinMode(FILL_PINS[i], OUTPUT);
        pinMode(VENT_PINS[i], OUTPUT);
        drive(i, VENTING);
    }
    analogReadResolution(12);
    analogReadAveraging(4);
    LINK.begin(BAUD);
    WDT_timings_t timings;
    timings.timeout = WATCHDOG_MS;  // in ms; the minimum of WDT3 is 32
    watchdog.begin(timings);
}

void loop() {
    int32_t channels[CHANNELS];
    receive();
    read_all(channels);
    core.tick(now_us(), channels);
    drive_all(channels);  // last, so that a vent acts in the same loop
    transmit();
    watchdog.feed();
}
