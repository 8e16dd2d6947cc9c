// SPDX-License-Identifier: Apache-2.0
#include "read/packets/packet_log.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <ranges>
#include <span>
#include <utility>

#include <fmt/ranges.h>

#include <relidar/base/math.hpp>

#include "base/fail.hpp"

namespace relidar::packets {
namespace {

constexpr int kMostFirings = 40000;  // more than in a revolution of two seconds
constexpr std::int64_t kMaxRevolution_ns = 2000000000;
// PacketIndexEntry stores the index of a packet in its message in 16 bits.
constexpr std::size_t kMostInMessage = 0xFFFF;
constexpr double kMostLost = 1e9;  // packets between two packets, if their times are damaged
// Revolutions begin at the rear, so that no scan is split in front of the vehicle.
constexpr double kRear_deg = 180.0;
// Largest 16-bit reflectivity, in units of 1/255: bin of the histogram of intensities.
constexpr double kMaxIntensityBin = 65535.0;
constexpr std::size_t kNormalBins = 256;  // bins of the intensities 0 to 1
// A larger azimuth step between two firings means that the sensor skips a sector.
constexpr double kMinAzimuthJump_deg = 5.0;
// The user gets a note about an incomplete revolution at the start or end of the
// recording only if more than this fraction of it was recorded.
constexpr double kCutOff = 0.02;

}  // namespace

void PacketIndex::add_packets(const std::vector<ReceivedPacket>& packets, std::int64_t recording_time_ns,
                              const MessagePosition& message_position,
                              const DecoderCalibration& calibration) {
    messages_.push_back({message_position, recording_time_ns});
    if (packets.size() > kMostInMessage)
        fail("a message has {} packets, expected at most {}", packets.size(), kMostInMessage);
    for (std::size_t i = 0; i < packets.size(); ++i) {
        const std::string_view bytes = packets[i].bytes;
        if (!product_) set_product(packets, calibration);
        // `calibration_` is that of the first message, which all packets must match. The
        // calibration of this message may name another product.
        if (find_product(bytes, calibration_) != product_) {
            const LidarProduct* other = find_product(bytes, calibration);
            fail("found a packet of {} bytes from {}, expected packets of a {} like before", bytes.size(),
                 other ? other->name : "an unknown product", product_->name);
        }
        index_packet(packets[i], std::uint16_t(i));
    }
}

/// Creates the decoder for the product that sent the packets of the first message.
void PacketIndex::set_product(const std::vector<ReceivedPacket>& packets, DecoderCalibration calibration) {
    const LidarProduct* product = find_product(packets.front().bytes, calibration);
    if (!product || !product->make) throw DataError(unsupported_text(product, packets.front().bytes));
    // The packets of an RS-LiDAR-16 do not state their number of returns.
    calibration.has_two_returns = is_dual_rs16(packets);
    decoder_ = product->make(product->name, calibration);
    product_ = product;
    calibration_ = std::move(calibration);
}

/// Decodes a packet and adds it to the index. If the sensor skips a sector within the
/// packet, adds an entry for each side, because time and azimuth jump there.
void PacketIndex::index_packet(const ReceivedPacket& packet_view, std::uint16_t index_in_message) {
    const DecodedPacket packet = decoder_->decode_packet(packet_view.bytes);
    if (packet.firings.empty()) {
        ++n_empty_;
        return;
    }
    slots_per_packet_ = packet.n_slots;
    const std::size_t n = packet.firings.size();
    const bool may_skip = !decoder_->timing().has_fixed_columns();
    // azimuth step from firing f to the next firing
    const auto step_deg = [&](std::size_t f) {
        return rotation_deg(packet.firings[f].azimuth_deg, packet.firings[f + 1].azimuth_deg);
    };
    std::vector<std::size_t> last_firings;  // of each entry
    for (std::size_t f = 0; f < n; ++f)
        if (f + 1 == n || (may_skip && step_deg(f) > kMinAzimuthJump_deg)) last_firings.push_back(f);
    // Width of the sectors between the time stamp and the current entry. It is negative
    // if the sectors follow the entry, because the time stamp refers to the last firing.
    double skipped_deg = 0.0;
    // `after_us` counts from the time stamp. The stamp is at the end if it is nearer to
    // the last firing than to the first.
    const bool is_stamp_at_end = packet.firings.back().after_us < -packet.firings.front().after_us;
    for (std::size_t k = 0; is_stamp_at_end && k + 1 < last_firings.size(); ++k)
        skipped_deg -= step_deg(last_firings[k]);

    std::size_t first = 0;  // firing of the current entry
    for (const std::size_t last : last_firings) {
        const bool is_last_entry = last + 1 == n;
        const LaserFiring& begin = packet.firings[first];
        const std::int64_t after_ns = std::llround(1e3 * begin.after_us);
        const int end_slot = is_last_entry ? slots_per_packet_ : packet.firings[last + 1].slot;
        Entry entry{.stamp_ns = packet_view.stamp_ns + after_ns,
                    .clock_ns = packet.clock_ns + after_ns,
                    .azimuth_deg = begin.azimuth_deg,
                    .turned_deg = 0.0f,
                    .skipped_deg = float(skipped_deg),
                    .message = std::uint32_t(messages_.size() - 1),
                    .in_message = index_in_message,
                    .first_firing = std::uint16_t(first),
                    .n_firings = std::uint16_t(last + 1 - first),
                    .first_slot = std::int16_t(begin.slot),
                    .n_slots = std::int16_t(end_slot - begin.slot),
                    .hash = std::uint32_t(std::hash<std::string_view>()(packet_view.bytes)),
                    .n_empty_before = n_empty_};
        n_empty_ = 0;
        for (std::size_t f = first; f < last; ++f) entry.turned_deg += float(step_deg(f));
        unwrap_clock(entry);
        packets_.push_back(entry);
        if (!is_last_entry) skipped_deg += step_deg(last);
        first = last + 1;
    }
    if (decoder_->timing().is_wide) count_intensities(packet);
}

/// Makes the sensor's clock continue the clock of the previous entry. The time stamps of
/// the packets show how often the clock has restarted.
void PacketIndex::unwrap_clock(Entry& entry) const {
    const double wrap_us = decoder_->timing().wrap_us;
    if (packets_.empty() || !(wrap_us > 0.0)) return;
    const Entry& before = packets_.back();
    const double passed_stamp_us = 1e-3 * double(entry.stamp_ns - before.stamp_ns),
                 passed_us = 1e-3 * double(entry.clock_ns - before.clock_ns);
    entry.clock_ns += std::llround(1e3 * wrap_us * std::round((passed_stamp_us - passed_us) / wrap_us));
}

/// Adds the returns of a packet to the histogram of intensities with bins of 1/255.
void PacketIndex::count_intensities(const DecodedPacket& packet) {
    for (const auto& returns : packet.echoes)
        for (const DecodedReturn& echo : returns) {
            const bool has_return = echo.range_m > 0.0f;
            if (!has_return) continue;
            const auto bin =
                std::size_t(std::clamp(std::round(255.0 * double(echo.intensity)), 0.0, kMaxIntensityBin));
            if (bin >= n_returns_of_bin_.size()) n_returns_of_bin_.resize(bin + 1);
            ++n_returns_of_bin_[bin];
        }
}

void PacketIndex::finish() {
    if (packets_.empty()) return;
    // Azimuths become continuous in the order of sending, which all later steps need.
    faults_ = sort_packets(packets_);
    // A packet with two entries counts once: its second entry begins at a later firing.
    n_packets_ = std::size_t(std::ranges::count(packets_, 0, &Entry::first_firing));
    const FiringTiming& timing = decoder_->timing();
    mean_deg_us_ = unwrap_azimuths(packets_, timing);
    // A sensor with fixed columns (azimuths) states at which of them it fires.
    if (!timing.has_fixed_columns() && mean_deg_us_ > 0.0)
        skipped_sector_ = find_skipped_sector(packets_, firing_step_deg());
    for (std::size_t p = 1; p < packets_.size(); ++p) {
        const Entry& before = packets_[p - 1];
        packets_[p].n_lost_before = timing.has_fixed_columns() ? count_lost_by_column(before, packets_[p])
                                                               : count_lost_by_time(before, packets_[p]);
    }
    find_revolutions();
}

/// Returns the mean rotation of the head from one firing to the next.
double PacketIndex::firing_step_deg() const { return mean_deg_us_ * decoder_->timing().cycle_us; }

/// Returns how many packets were lost between two packets of a sensor that fires at any
/// azimuth. Such a sensor sends a packet after a fixed number of firings.
std::uint32_t PacketIndex::count_lost_by_time(const Entry& before, const Entry& entry) const {
    // Times are counted in firing cycles (slots). The sensor does not fire while the head
    // passes the skipped sector.
    const double skipped_deg = skipped_sector_.overlap_deg(before.azimuth_deg, entry.azimuth_deg);
    const double skipped_slots = skipped_deg > 0.0 ? skipped_deg / firing_step_deg() : 0.0;
    const double elapsed_slots =
        1e-3 * double(entry.clock_ns - before.clock_ns) / decoder_->timing().cycle_us;
    const double lost_slots = elapsed_slots - skipped_slots - before.n_slots;
    return std::uint32_t(std::clamp(std::round(lost_slots / double(slots_per_packet_)), 0.0, kMostLost));
}

/// Returns the column at an azimuth, for a sensor that fires at fixed azimuths. Columns
/// count from the rear, over all revolutions.
std::int64_t PacketIndex::column_at(double azimuth_deg) const {
    return std::llround((azimuth_deg - kRear_deg) / (360.0 / double(decoder_->timing().fires.size())));
}

/// Returns the first column of a packet. Its other columns (slots) follow.
std::int64_t PacketIndex::first_column(const Entry& packet) const {
    return column_at(packet.azimuth_deg) - packet.first_slot;
}

/// Returns how many packets were lost between two packets of a sensor that fires at fixed
/// azimuths. Its packets divide all columns into groups of equal size. The sensor may not
/// send a packet for a group without a firing, so such a packet is not lost.
std::uint32_t PacketIndex::count_lost_by_column(const Entry& before, const Entry& entry) const {
    const FiringTiming& timing = decoder_->timing();
    const std::int64_t group = slots_per_packet_;  // columns per packet
    const double n_groups = std::round(double(first_column(entry) - first_column(before)) / double(group));
    const auto n_between = std::uint32_t(std::clamp(n_groups, 1.0, kMostLost)) - 1;
    // After a pause of more than two revolutions, the loop below would be slow.
    if (std::size_t(n_between) * std::size_t(group) > 2 * timing.fires.size()) return n_between;
    std::uint32_t n_with_firing = 0;
    for (std::uint32_t k = 1; k <= n_between; ++k) {
        const auto columns =
            std::views::iota(first_column(before) + k * group, first_column(before) + (k + 1) * group);
        if (std::ranges::any_of(columns, [&](std::int64_t column) { return timing.fires_at(column); }))
            ++n_with_firing;
    }
    // Packets without a firing that were received are not lost either.
    const std::uint32_t n_received = std::min<std::uint32_t>(n_between, entry.n_empty_before);
    return std::min(n_with_firing, n_between - n_received);
}

/// Counts the lost packets of a revolution. If packets were lost at its start or end,
/// counts only the part that belongs to this revolution.
void PacketIndex::store_lost_packets(PacketRevolution& revolution) const {
    const double end_deg = revolution.begin_deg + 360.0;
    double n_missing = 0.0;
    // The packet after the revolution shows the losses at the end.
    const std::size_t last_tested = std::min(revolution.last + 1, packets_.size() - 1);
    for (std::size_t i = revolution.first + 1; i <= last_tested; ++i) {
        const Entry &before = packets_[i - 1], &after = packets_[i];
        // Head azimuths of the gap: from one step after the last firing before it to the
        // first firing after it. The lost packets are evenly spread over it.
        const double from_deg = before.azimuth_deg + double(before.turned_deg) + firing_step_deg();
        const double to_deg = after.azimuth_deg, gap_deg = std::max(to_deg - from_deg, 1e-6);
        const double within_deg = std::min(to_deg, end_deg) - std::max(from_deg, revolution.begin_deg);
        n_missing += double(after.n_lost_before) * std::clamp(within_deg / gap_deg, 0.0, 1.0);
    }
    revolution.n_missing = std::size_t(std::llround(n_missing));
    revolution.has_gaps = n_missing > 0.0;
}

/// Returns the range of head azimuths that was recorded. If the sensor never fires just
/// before or after it, includes these azimuths, because no packets are missing there.
std::pair<double, double> PacketIndex::azimuth_range_deg() const {
    const FiringTiming& timing = decoder_->timing();
    const Entry &first = packets_.front(), &last = packets_.back();
    const double last_firing_deg = last.azimuth_deg + double(last.turned_deg);
    if (timing.has_fixed_columns()) {
        // The sensor fires at some columns (fixed azimuths) of a revolution. Adds the
        // columns without firings on both sides, at most n.
        const std::size_t n = timing.fires.size();
        std::int64_t begin = column_at(first.azimuth_deg), end = column_at(last_firing_deg) + 1;
        for (std::size_t k = 0; k < n && !timing.fires_at(begin - 1); ++k) --begin;
        for (std::size_t k = 0; k < n && !timing.fires_at(end); ++k) ++end;
        const double column_deg = 360.0 / double(n);
        return {kRear_deg + column_deg * double(begin), kRear_deg + column_deg * double(end)};
    }
    // The skipped sector begins one step after the last firing before it, and ends at the
    // first firing after it. The second step is a margin.
    const double step_deg = firing_step_deg();
    const bool starts_behind_sector =
        skipped_sector_.overlap_deg(first.azimuth_deg - step_deg, first.azimuth_deg) > 0.0;
    const bool ends_before_sector =
        skipped_sector_.overlap_deg(last_firing_deg, last_firing_deg + 2.0 * step_deg) > 0.0;
    // Otherwise ends where the last packet begins. So after each revolution, there is a
    // packet that shows losses at its end.
    return {starts_behind_sector ? first.azimuth_deg - skipped_sector_.width_deg : first.azimuth_deg,
            ends_before_sector ? last_firing_deg + skipped_sector_.width_deg : last.azimuth_deg};
}

/// Returns the index of the first packet that begins after an azimuth.
std::size_t PacketIndex::packet_behind(double azimuth_deg) const {
    return std::size_t(std::ranges::upper_bound(packets_, azimuth_deg, {}, &Entry::azimuth_deg) -
                       packets_.begin());
}

/// Returns the revolution that begins at an azimuth, with its first and last packet. Its
/// first packet can begin before the revolution.
PacketRevolution PacketIndex::make_revolution(double begin_deg) const {
    PacketRevolution revolution{.first = std::max(packet_behind(begin_deg), std::size_t(1)) - 1,
                                .last = packet_behind(begin_deg + 360.0) - 1,
                                .begin_deg = begin_deg};
    // The second firing sequence of the last column can be in the next packet.
    if (decoder_->timing().n_sequences > 1)
        revolution.last = std::min(revolution.last + 1, packets_.size() - 1);
    return revolution;
}

/// Keeps a revolution if it is usable. Otherwise counts it by reason, for the notes.
void PacketIndex::keep_if_usable(PacketRevolution revolution) {
    store_lost_packets(revolution);
    set_times(revolution);
    const std::size_t n_received = revolution.last - revolution.first;
    // Half as many lost as received packets means that a third of all is missing.
    if (2 * revolution.n_missing >= n_received) ++left_out_.n_lost;
    else if (!has_steady_clock(revolution)) ++left_out_.n_jumps;
    else revolutions_.push_back(revolution);
}

/// Divides the recording into revolutions, which begin at the rear, and keeps the usable
/// ones. Revolution t extends from the azimuth kRear_deg + 360 t to that of t + 1.
void PacketIndex::find_revolutions() {
    const auto [first_deg, end_deg] = azimuth_range_deg();
    const auto begin_of = [](double turn) { return kRear_deg + 360.0 * turn; };
    // Returns true if a recorded part of an incomplete revolution is not negligible. No
    // packets are sent in the skipped sector.
    const auto is_cut_off = [&](double from_deg, double to_deg) {
        return to_deg - from_deg - skipped_sector_.overlap_deg(from_deg, to_deg) > 360.0 * kCutOff;
    };
    double turn = std::ceil((first_deg - kRear_deg) / 360.0);  // the first complete revolution
    if (is_cut_off(first_deg, begin_of(turn))) ++left_out_.n_cut_off;
    while (begin_of(turn + 1.0) <= end_deg) {
        const PacketRevolution revolution = make_revolution(begin_of(turn));
        double next_turn = turn + 1.0;
        const bool are_all_lost = revolution.first == revolution.last;
        if (are_all_lost) {
            // A pause can be long, so continues with the turn of the next packet.
            const std::size_t next = std::min(packet_behind(begin_of(next_turn)), packets_.size() - 1);
            next_turn = std::max(next_turn, std::floor((packets_[next].azimuth_deg - kRear_deg) / 360.0));
            left_out_.n_lost += std::size_t(next_turn - turn);
        } else {
            keep_if_usable(revolution);
        }
        turn = next_turn;
    }
    if (is_cut_off(begin_of(turn), end_deg)) ++left_out_.n_cut_off;
}

std::string PacketIndex::describe_faults() const {
    std::vector<std::string> texts;
    const auto add = [&](std::size_t count, const char* text) {
        if (count > 0) texts.push_back(fmt::format("{} {}", count, text));
    };
    add(faults_.n_repeated, "packets were received twice");
    add(faults_.n_late, "packets were received out of order and are sorted by the clock of the sensor");
    const Entry &first = packets_.front(), &last = packets_.back();
    const double all_deg = last.azimuth_deg + double(last.turned_deg) - first.azimuth_deg;
    const bool is_short = revolutions_.empty() && all_deg < 360.0;
    if (is_short) {
        texts.push_back(fmt::format("the packets cover only {:.0f} degrees of a revolution, expected 360",
                                    std::max(all_deg, 0.0)));
    } else {
        add(left_out_.n_cut_off, "revolutions are skipped, because the recording begins or ends during them");
    }
    add(left_out_.n_lost, "revolutions are skipped, because at least a third of their packets is missing");
    add(left_out_.n_jumps,
        "revolutions are skipped, because the clock of the sensor jumps during them, or because packets of "
        "two sensors are mixed");
    if (skipped_sector_.width_deg > 0.0)
        texts.push_back(fmt::format(
            "the sensor fires in {:.0f} degrees of a revolution, so the other {:.0f} degrees have no rays",
            360.0 - skipped_sector_.width_deg, skipped_sector_.width_deg));
    return fmt::format("{}", fmt::join(texts, "; "));
}

/// Sets the times of a revolution. A sensor that fires at fixed azimuths is timed by its
/// clock, any other sensor by the receive times of its packets.
void PacketIndex::set_times(PacketRevolution& revolution) const {
    // The revolution begins at the rear, so the head faces forward half a turn later.
    // Interpolates the clock between the packets before and after.
    const double forward_deg = revolution.begin_deg + 180.0;
    const std::size_t k = std::clamp(packet_behind(forward_deg), std::size_t(1), packets_.size() - 1);
    const Entry &before = packets_[k - 1], &after = packets_[k];
    const double share =
        (forward_deg - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
    const std::int64_t forward_clock_ns =
        before.clock_ns + std::int64_t(share * double(after.clock_ns - before.clock_ns));

    std::int64_t stamp_less_clock_ns = before.stamp_ns - before.clock_ns;
    // A network delay makes a time stamp later, so the smallest difference is used.
    if (decoder_->timing().has_fixed_columns())
        for (std::size_t i = revolution.first; i <= revolution.last; ++i)
            stamp_less_clock_ns = std::min(stamp_less_clock_ns, packets_[i].stamp_ns - packets_[i].clock_ns);
    revolution.forward_ns = forward_clock_ns + stamp_less_clock_ns;
    revolution.log_ns = messages_[before.message].log_ns;
    revolution.stamp_less_clock_ns = stamp_less_clock_ns;
    // If the clock restarts at 0 after each period of `wrap_us`, the difference is only
    // known up to full periods. Keeps the remainder nearest to 0.
    if (const double wrap_us = decoder_->timing().wrap_us; wrap_us > 0.0)
        revolution.stamp_less_clock_ns =
            std::llround(std::remainder(double(stamp_less_clock_ns), 1e3 * wrap_us));
}

/// Returns true if the sensor's clock advances in each packet by at least half of the
/// nominal time. Returns false if the revolution is too long.
bool PacketIndex::has_steady_clock(const PacketRevolution& revolution) const {
    const double slot_ns = 1e3 * decoder_->timing().cycle_us;
    for (std::size_t i = revolution.first + 1; i <= revolution.last; ++i) {
        const Entry &entry = packets_[i], &before = packets_[i - 1];
        if (double(entry.clock_ns - before.clock_ns) < 0.5 * slot_ns * before.n_slots) return false;
    }
    return packets_[revolution.last].clock_ns - packets_[revolution.first].clock_ns <= kMaxRevolution_ns;
}

/// Returns the first and the last message that contain packets of a revolution. Packets
/// are sorted by time, but their messages can be in another order.
std::pair<std::uint32_t, std::uint32_t> PacketIndex::message_range(const PacketRevolution& revolution) const {
    const auto packets =
        std::span(packets_).subspan(revolution.first, revolution.last + 1 - revolution.first);
    const auto [first, last] = std::ranges::minmax(packets, {}, &Entry::message);
    return {first.message, last.message};
}

std::vector<PacketIndex::MessageSource> PacketIndex::messages_of(const PacketRevolution& revolution) const {
    const auto [first, last] = message_range(revolution);
    return {messages_.begin() + first, messages_.begin() + last + 1};
}

/// Returns the mean azimuth step between two firings of a revolution, including lost
/// firings. Excludes the sector in which the sensor never fires.
double PacketIndex::mean_step_deg(const PacketRevolution& revolution) const {
    std::size_t n = 0;
    for (std::size_t i = revolution.first; i < revolution.last; ++i)
        n +=
            std::size_t(packets_[i].n_slots) + packets_[i + 1].n_lost_before * std::size_t(slots_per_packet_);
    const double first_deg = packets_[revolution.first].azimuth_deg,
                 last_deg = packets_[revolution.last].azimuth_deg;
    return std::max(last_deg - first_deg - skipped_sector_.overlap_deg(first_deg, last_deg), 1.0) /
           double(std::max<std::size_t>(n, 1));
}

SpinningSensor PacketIndex::make_sensor() const {
    // 360 degrees divided by the rate in degrees per microsecond, which may be damaged.
    const double period_s = std::clamp(360e-6 / std::max(mean_deg_us_, 1e-9), 0.02, 1.0);
    const FiringTiming& timing = decoder_->timing();
    if (timing.has_fixed_columns()) return decoder_->make_sensor(int(timing.fires.size()), 1.0 / period_s);
    // All firings of the revolution with the most firings must fit into the scan, whose
    // columns have one firing of each sequence. One column more is a margin.
    double n_firings = 1e6 * period_s / timing.cycle_us;  // in a turn
    for (const PacketRevolution& revolution : revolutions_)
        n_firings = std::max(n_firings, 360.0 / mean_step_deg(revolution));
    const int n_columns = int(std::ceil(n_firings / double(timing.n_sequences))) + 1;
    return decoder_->make_sensor(std::min(n_columns, kMostFirings), 1.0 / period_s);
}

/// Returns the value by which intensities are divided: 1 if none exceeds 1. Otherwise the
/// 99.5th percentile of the intensities of all returns, by a histogram.
double PacketIndex::full_scale() const {
    if (n_returns_of_bin_.size() <= kNormalBins) return 1.0;
    const auto n_returns =
        std::accumulate(n_returns_of_bin_.begin(), n_returns_of_bin_.end(), std::uint64_t(0));
    // index of the percentile in the returns, darkest first
    const auto percentile = std::uint64_t(0.995 * double(n_returns - 1));
    std::size_t bin = 0;
    std::uint64_t n_up_to_bin = n_returns_of_bin_[0];  // returns in the bins 0 to `bin`
    while (n_up_to_bin <= percentile) n_up_to_bin += n_returns_of_bin_[++bin];
    return std::max(double(bin), 1.0) / 255.0;
}

std::string PacketIndex::describe_product() const {
    if (n_returns_of_bin_.size() <= kNormalBins) return decoder_->describe_product();
    return fmt::format("{}, reflectivities up to {:.4g} are divided by {:.4g}, their 99.5th percentile",
                       decoder_->describe_product(), double(n_returns_of_bin_.size() - 1),
                       255.0 * full_scale());
}

}  // namespace relidar::packets
