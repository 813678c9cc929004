// What a manifold does with the bytes it gets: the state machine of docs/reference/rig_protocol.md, without a board.
// rig/simulated/manifold.py is its twin; tests/rig/firmware/test_core.py holds them together byte for byte.
#pragma once

#include "frames.h"
#include "messages.h"
#include "ring.h"

namespace slider {

// What this manifold is, as Ident tells it.
struct Settings {
    uint16_t protocol;
    uint8_t version[3];
    uint16_t longest;                // samples of a waveform
    uint16_t rate;                   // readings a second
    int32_t hard_limits[CHAMBERS];   // [Pa] that no command can raise
};

struct Sample {
    int32_t pressure[CHAMBERS];  // [Pa]; the first below zero while the sample has not come
};

// Times are the device's microseconds since its start, and never go back.
class ManifoldCore {
public:
    // `wave` has room for `settings.longest` samples, and lives as long as the core.
    ManifoldCore(const Settings& settings, Sample* wave, Ring& out)
        : settings_(settings), wave_(wave), out_(out) {}

    // Takes bytes from the host.
    void feed(const uint8_t* bytes, size_t size, uint64_t now_us);
    // One pass of the main loop, with channels as just read.
    void tick(uint64_t now_us, const int32_t (&channels)[CHANNELS]);

    // (4,) that the valves follow [Pa]; null while all vent.
    const int32_t* set_pressures() const {
        return state_ == State::ARMED || state_ == State::PLAYING ? set_ : nullptr;
    }
    State state() const { return state_; }
    // Frames that were no command.
    uint32_t damaged() const { return decoder_.damaged() + foreign_; }

private:
    // Why pressures are refused: DONE if they are not.
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
    void say(const Body& body, size_t spare = 0);
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
    uint16_t command_ = 0;    // seq of the last SetPressures accepted
    uint16_t changes_ = 0;    // of the set pressures that were told
    uint32_t readings_ = 0;
    uint64_t heard_ = 0;
    bool running_ = false;    // a first pass was made
    uint64_t due_ = 0;        // of the next reading

    uint16_t samples_ = 0;    // of the waveform; 0: none
    uint32_t period_ = 0;
    uint32_t repeats_ = 0;
    uint64_t begun_ = 0;
};

}  // namespace slider
