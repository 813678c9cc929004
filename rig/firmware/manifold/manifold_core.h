// The manifold's state machine (docs/reference/rig_protocol.md), which needs no board. The tests compare its messages
// byte for byte with the messages of rig/simulated/manifold.py.
#pragma once

#include "frames.h"
#include "messages.h"
#include "ring.h"

namespace slider {

// Properties of this manifold, sent in Ident.
struct Settings {
    uint16_t protocol;
    uint8_t version[3];
    uint16_t longest;                // largest number of samples in a waveform
    uint16_t rate;                   // readings per second
    int32_t hard_limits[CHAMBERS];   // [Pa], which no command can exceed
};

struct Sample {
    int32_t pressure[CHAMBERS];  // [Pa]; the first is negative until the sample arrives
};

// Times are microseconds since the device's start and never decrease.
class ManifoldCore {
public:
    // `wave` has room for `settings.longest` samples and must outlive the core.
    ManifoldCore(const Settings& settings, Sample* wave, Ring& out)
        : settings_(settings), wave_(wave), out_(out) {}

    // Takes bytes from the host.
    void feed(const uint8_t* bytes, size_t size, uint64_t now_us);
    // Runs the main loop once with the newest channels.
    void tick(uint64_t now_us, const int32_t (&channels)[CHANNELS]);

    // Set pressures (CHAMBERS,) [Pa] that the valves follow; null while all vent.
    const int32_t* set_pressures() const {
        return state_ == State::ARMED || state_ == State::PLAYING ? set_ : nullptr;
    }
    State state() const { return state_; }
    // Number of frames that were not a command.
    uint32_t damaged() const { return decoder_.damaged() + foreign_; }

private:
    // Reason for refusing a command; DONE for an accepted command.
    struct Verdict {
        Answer answer = Answer::DONE;
        int32_t detail = 0;
    };

    void obey(const uint8_t* body, size_t size, uint64_t now_us);
    Verdict limit(const uint8_t* pressures);
    Verdict follow(uint16_t seq, const uint8_t* pressures, uint64_t now_us);
    Verdict arm();
    Verdict begin(uint16_t samples, uint32_t period_us);
    Verdict take(uint16_t first, const uint8_t* pressures, size_t samples);
    Verdict start(uint32_t repeats, uint64_t now_us);
    void watch(uint64_t now_us);
    void play(uint64_t now_us);
    void check(uint64_t now_us, const int32_t (&channels)[CHANNELS]);
    void fault(uint64_t now_us, Cause cause, int32_t detail);
    void send(const Body& body, size_t spare = 0);
    void ident();
    void ack(const uint8_t* body, Verdict verdict);
    void event(uint64_t now_us, Cause cause, int32_t detail);
    void set(const int32_t (&pressures)[CHAMBERS], uint64_t now_us);
    void follows(uint64_t now_us);
    void reading(const int32_t (&channels)[CHANNELS]);
    static Verdict outside(const uint8_t* pressures, const int32_t (&limits)[CHAMBERS]);

    const Settings settings_;
    Sample* const wave_;
    Ring& out_;
    Decoder decoder_;
    uint32_t foreign_ = 0;

    State state_ = State::BOOT;
    int32_t limits_[CHAMBERS] = {};
    int32_t set_[CHAMBERS] = {};
    uint16_t command_ = 0;    // seq of the last accepted SetPressures
    uint16_t changes_ = 0;    // number of Follows messages sent
    uint32_t readings_ = 0;
    uint64_t last_command_ = 0;
    bool running_ = false;    // whether the main loop has run once
    uint64_t due_ = 0;        // time of the next reading

    uint16_t samples_ = 0;    // number of the waveform's samples; 0: no waveform
    uint32_t period_ = 0;
    uint32_t repeats_ = 0;
    uint64_t wave_start_ = 0;
};

}  // namespace slider
