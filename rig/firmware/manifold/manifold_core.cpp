#include "manifold_core.h"

namespace slider {

static_assert(sizeof(Body::bytes) <= LONGEST_BODY, "a Reading must fit into a frame");

// Readings do not use these bytes of the buffer. They are reserved for answers and events to a slow host.
static constexpr size_t RESERVED_FOR_ANSWERS = 1024;

void ManifoldCore::feed(const uint8_t* bytes, size_t size, uint64_t now_us) {
    watch(now_us);
    for (size_t i = 0; i < size; ++i) {
        if (!decoder_.take(bytes[i])) continue;
        if (from_host(decoder_.body(), decoder_.size())) {
            last_command_ = now_us;
            obey(decoder_.body(), decoder_.size(), now_us);
        } else {
            ++foreign_;
        }
    }
}

void ManifoldCore::tick(uint64_t now_us, const int32_t (&channels)[CHANNELS]) {
    const uint64_t period = 1000000 / settings_.rate;
    if (!running_) {
        running_ = true;
        due_ = now_us + period;
        event(now_us, Cause::RESET, 0);
    }
    watch(now_us);
    play(now_us);
    check(now_us, channels);
    for (; due_ <= now_us; due_ += period) reading(channels);
}

void ManifoldCore::watch(uint64_t now_us) {
    const uint64_t silence = now_us - last_command_;
    if (set_pressures() == nullptr || silence < WATCHDOG_US) return;
    fault(now_us, Cause::WATCHDOG, static_cast<int32_t>(silence / 1000));
}

void ManifoldCore::play(uint64_t now_us) {
    if (state_ != State::PLAYING) return;
    const uint64_t sample = (now_us - wave_start_) / period_;
    const bool ended = repeats_ != 0 && sample >= static_cast<uint64_t>(repeats_) * samples_;
    const Sample& now = wave_[ended ? samples_ - 1u : sample % samples_];
    set(now.pressure, now_us);
    if (!ended) return;
    state_ = State::ARMED;
    event(now_us, Cause::PLAYED, 0);
}

void ManifoldCore::check(uint64_t now_us, const int32_t (&channels)[CHANNELS]) {
    if (set_pressures() == nullptr) return;
    for (size_t i = 0; i < CHAMBERS; ++i) {
        // 1.1 limit + 5000 Pa in integers, so all processors get the same result.
        if (10 * static_cast<int64_t>(channels[i]) > 11 * static_cast<int64_t>(limits_[i]) + 50000) {
            fault(now_us, Cause::OVER_PRESSURE, static_cast<int32_t>(i));
            return;
        }
    }
}

void ManifoldCore::fault(uint64_t now_us, Cause cause, int32_t detail) {
    state_ = State::FAULT;
    event(now_us, cause, detail);
}

void ManifoldCore::obey(const uint8_t* body, size_t size, uint64_t now_us) {
    const uint8_t* fields = body + 3;
    Verdict verdict;
    switch (body[0]) {
        case HELLO:
            ident();
            return;
        case HEARTBEAT:
            return;
        case STOP:
            if (set_pressures() != nullptr) state_ = State::READY;
            ack(body, verdict);
            event(now_us, Cause::STOPPED, 0);
            return;
        case SET_LIMITS:
            verdict = limit(fields);
            ack(body, verdict);
            if (verdict.answer != Answer::DONE && state_ != State::BOOT && state_ != State::FAULT)
                fault(now_us, Cause::REFUSED, verdict.detail);
            return;
        case ARM:
            verdict = arm();
            ack(body, verdict);
            if (verdict.answer == Answer::DONE) follows(now_us);
            return;
        case SET_PRESSURES:
            verdict = follow(get_u16(body + 1), fields, now_us);
            if (verdict.answer == Answer::DONE) return;
            ack(body, verdict);
            if (verdict.answer != Answer::WRONG_STATE) fault(now_us, Cause::REFUSED, verdict.detail);
            return;
        case WAVE_BEGIN:
            ack(body, begin(get_u16(fields), get_u32(fields + 2)));
            return;
        case WAVE_PIECE:
            ack(body, take(get_u16(fields), fields + 2, (size - 5) / SAMPLE_BYTES));
            return;
        case WAVE_PLAY:
            verdict = start(get_u32(fields), now_us);
            ack(body, verdict);
            if (verdict.answer == Answer::DONE) play(now_us);
            return;
    }
}

ManifoldCore::Verdict ManifoldCore::limit(const uint8_t* pressures) {
    const Verdict verdict = outside(pressures, settings_.hard_limits);
    if (verdict.answer != Answer::DONE) return verdict;
    for (size_t i = 0; i < CHAMBERS; ++i) limits_[i] = get_i32(pressures + 4 * i);
    samples_ = 0;
    state_ = State::READY;
    return {};
}

ManifoldCore::Verdict ManifoldCore::arm() {
    if (state_ != State::READY) return {Answer::WRONG_STATE, 0};
    state_ = State::ARMED;
    for (int32_t& pressure : set_) pressure = 0;
    return {};
}

ManifoldCore::Verdict ManifoldCore::follow(uint16_t seq, const uint8_t* pressures, uint64_t now_us) {
    if (state_ != State::ARMED) return {Answer::WRONG_STATE, 0};
    const Verdict verdict = outside(pressures, limits_);
    if (verdict.answer != Answer::DONE) return verdict;
    int32_t wanted[CHAMBERS];
    for (size_t i = 0; i < CHAMBERS; ++i) wanted[i] = get_i32(pressures + 4 * i);
    set(wanted, now_us);
    command_ = seq;
    return {};
}

ManifoldCore::Verdict ManifoldCore::begin(uint16_t samples, uint32_t period_us) {
    if (state_ != State::READY && state_ != State::ARMED) return {Answer::WRONG_STATE, 0};
    const bool fits = samples >= 2 && samples <= settings_.longest;
    if (!fits || period_us < 500 || period_us > 1000000) return {Answer::WRONG_PLACE, 0};
    samples_ = samples;
    period_ = period_us;
    for (size_t i = 0; i < samples; ++i) wave_[i].pressure[0] = -1;
    return {};
}

ManifoldCore::Verdict ManifoldCore::take(uint16_t first, const uint8_t* pressures, size_t samples) {
    if (state_ != State::READY && state_ != State::ARMED) return {Answer::WRONG_STATE, 0};
    if (first + samples > samples_) return {Answer::WRONG_PLACE, 0};
    for (size_t i = 0; i < samples; ++i) {
        const Verdict verdict = outside(pressures + SAMPLE_BYTES * i, limits_);
        if (verdict.answer != Answer::DONE) {
            samples_ = 0;
            return verdict;
        }
        for (size_t k = 0; k < CHAMBERS; ++k)
            wave_[first + i].pressure[k] = get_i32(pressures + SAMPLE_BYTES * i + 4 * k);
    }
    return {};
}

ManifoldCore::Verdict ManifoldCore::start(uint32_t repeats, uint64_t now_us) {
    if (state_ != State::ARMED) return {Answer::WRONG_STATE, 0};
    if (samples_ == 0) return {Answer::WRONG_PLACE, 0};
    for (size_t i = 0; i < samples_; ++i)
        if (wave_[i].pressure[0] < 0) return {Answer::WRONG_PLACE, 0};
    state_ = State::PLAYING;
    repeats_ = repeats;
    wave_start_ = now_us;
    return {};
}

ManifoldCore::Verdict ManifoldCore::outside(const uint8_t* pressures, const int32_t (&limits)[CHAMBERS]) {
    for (size_t i = 0; i < CHAMBERS; ++i) {
        const int32_t pressure = get_i32(pressures + 4 * i);
        if (pressure < 0) return {Answer::BELOW_ZERO, static_cast<int32_t>(i)};
        if (pressure > limits[i]) return {Answer::ABOVE_LIMIT, static_cast<int32_t>(i)};
    }
    return {};
}

void ManifoldCore::send(const Body& body, size_t spare) {
    uint8_t frame[LONGEST_FRAME];
    out_.push(frame, encode(body.bytes, body.size, frame), spare);
}

void ManifoldCore::ident() {
    Body body(IDENT);
    body.u16(settings_.protocol);
    for (uint8_t number : settings_.version) body.u8(number);
    body.u16(settings_.longest).u16(settings_.rate);
    for (int32_t hard : settings_.hard_limits) body.i32(hard);
    send(body);
}

void ManifoldCore::ack(const uint8_t* body, Verdict verdict) {
    const uint8_t answer = static_cast<uint8_t>(verdict.answer);
    send(Body(ACK).u16(get_u16(body + 1)).u8(body[0]).u8(answer).i32(verdict.detail));
}

void ManifoldCore::event(uint64_t now_us, Cause cause, int32_t detail) {
    send(Body(EVENT).u64(now_us).u8(static_cast<uint8_t>(cause)).i32(detail));
}

void ManifoldCore::set(const int32_t (&pressures)[CHAMBERS], uint64_t now_us) {
    bool changes = false;
    for (size_t i = 0; i < CHAMBERS; ++i) {
        changes = changes || set_[i] != pressures[i];
        set_[i] = pressures[i];
    }
    if (changes) follows(now_us);
}

void ManifoldCore::follows(uint64_t now_us) {
    Body body(FOLLOWS);
    body.u16(changes_++).u64(now_us);
    for (int32_t pressure : set_) body.i32(pressure);
    send(body);
}

void ManifoldCore::reading(const int32_t (&channels)[CHANNELS]) {
    Body body(READING);
    body.u32(readings_++).u64(due_).u8(static_cast<uint8_t>(state_)).u16(command_);
    for (int32_t channel : channels) body.i32(channel);
    send(body, RESERVED_FOR_ANSWERS);
}

}  // namespace slider
