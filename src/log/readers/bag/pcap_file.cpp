// SPDX-License-Identifier: Apache-2.0
// Reads network captures (pcap, pcapng, also compressed with gzip) with libpcap. The
// packets of each LiDAR become a topic. The topic is named after the LiDAR's address and
// the destination port. Up to kRun packets of a topic form one message. The position of a
// message is the byte offset of its first packet in the file.
#include <arpa/inet.h>
#include <pcap/pcap.h>

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <tuple>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/files.hpp"
#include "log/readers/bag/bag_file.hpp"
#include "log/readers/bag/packets/decoder.hpp"
#include "log/readers/bag/packets/livox.hpp"
#include "log/readers/bag/packets/ouster.hpp"
#include "log/readers/bag/packets/packet_messages.hpp"
#include "log/readers/bag/unpacked_file.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kRun = 64, kMostStreams = 256, kMostPending = 64, kMostDatagram = 65535;
constexpr unsigned kIpv4 = 0x0800, kIpv6 = 0x86dd, kUdp = 17;
// All fragments of a datagram arrive within this time. Identification numbers repeat
// later for other datagrams.
constexpr std::int64_t kTogether_ns = 1000000000;

unsigned read_big_endian(std::string_view bytes, std::size_t offset) {
    return offset + 2 <= bytes.size() ? static_cast<unsigned char>(bytes[offset]) * 256u +
                                            static_cast<unsigned char>(bytes[offset + 1])
                                      : 0u;
}
unsigned get_byte_at(std::string_view bytes, std::size_t offset) {
    return offset < bytes.size() ? static_cast<unsigned char>(bytes[offset]) : 0u;
}

/// An unfragmented IP packet, or one fragment of an IP packet.
struct IpPacket {
    /// Address of the sender as text, and the bytes that are equal in all fragments of a
    /// datagram.
    std::string from, key;
    std::size_t offset = 0;  ///< byte offset of the fragment in the packet; 0 for an unfragmented packet
    bool has_more = false;   ///< true if more fragments follow this fragment
    std::string_view payload;
};

std::optional<IpPacket> read_ipv4(std::string_view packet) {
    const std::size_t head = 4 * (get_byte_at(packet, 0) & 15);
    // Removes the padding of the Ethernet frame. A length of 0 is ignored, because
    // network cards that split packets do not write the length.
    if (const std::size_t length = read_big_endian(packet, 2); length >= 20)
        packet = packet.substr(0, length);
    if (head < 20 || packet.size() < head || get_byte_at(packet, 9) != kUdp) return std::nullopt;
    const unsigned flags = read_big_endian(packet, 6);
    return IpPacket{fmt::format("{}.{}.{}.{}", get_byte_at(packet, 12), get_byte_at(packet, 13),
                                get_byte_at(packet, 14), get_byte_at(packet, 15)),
                    std::string(packet.substr(12, 8)).append(packet.substr(4, 2)),
                    std::size_t(8 * (flags & 0x1fff)), (flags & 0x2000) != 0, packet.substr(head)};
}

std::optional<IpPacket> read_ipv6(std::string_view packet) {
    constexpr std::size_t kHead = 40, kFragmentHead = 8;
    constexpr unsigned kFragment = 44, kHopByHop = 0, kRouting = 43, kOptions = 60;
    if (packet.size() < kHead) return std::nullopt;
    std::array<char, INET6_ADDRSTRLEN> text{};
    inet_ntop(AF_INET6, packet.data() + 8, text.data(), text.size());
    IpPacket result{fmt::format("[{}]", text.data()), std::string(packet.substr(8, 32)), 0, false, {}};
    unsigned next = get_byte_at(packet, 6);
    std::string_view rest = packet.substr(kHead, read_big_endian(packet, 4));
    while (next == kHopByHop || next == kRouting || next == kOptions || next == kFragment) {
        const std::size_t size = next == kFragment ? kFragmentHead : 8 * (1 + get_byte_at(rest, 1));
        if (rest.size() < size) return std::nullopt;
        if (next == kFragment) {
            result.offset = read_big_endian(rest, 2) & 0xfff8,
            result.has_more = (read_big_endian(rest, 2) & 1) != 0;
            result.key.append(rest.substr(4, 4));
        }
        next = get_byte_at(rest, 0);
        rest.remove_prefix(size);
    }
    result.payload = rest;
    return next == kUdp ? std::optional(std::move(result)) : std::nullopt;
}

/// Returns the UDP packet in a captured network frame, or nothing if the frame contains
/// another protocol.
std::optional<IpPacket> parse_ip_packet(std::string_view frame, int link) {
    std::size_t head = 0;
    unsigned type = 0;
    if (link == DLT_EN10MB) head = 14, type = read_big_endian(frame, 12);
    if (link == DLT_LINUX_SLL) head = 16, type = read_big_endian(frame, 14);
    if (link == DLT_LINUX_SLL2) head = 20, type = read_big_endian(frame, 0);
    if (link == DLT_NULL || link == DLT_LOOP) head = 4;
    // skips VLAN tags
    for (; type == 0x8100 || type == 0x88a8 || type == 0x9100; head += 4)
        type = read_big_endian(frame, head + 2);
    if (frame.size() < head + 20) return std::nullopt;
    const std::string_view packet = frame.substr(head);
    const unsigned version = get_byte_at(packet, 0) >> 4;
    if (version == 4 && (type == 0 || type == kIpv4)) return read_ipv4(packet);
    if (version == 6 && (type == 0 || type == kIpv6)) return read_ipv6(packet);
    return std::nullopt;
}

/// A UDP datagram of a sensor.
struct Datagram {
    std::string source;    ///< address of the sender and destination port, for example "192.168.1.201:2368"
    std::uint64_t at = 0;  ///< byte offset in the file of the first frame of the datagram
    std::int64_t stamp_ns = 0;
    std::string bytes;
};

/// Reassembles fragmented IP packets. Fragments may be late or repeated, and fragments of
/// several packets may be interleaved.
class Fragments {
public:
    /// Adds an IP packet or a fragment.
    /// @return UDP header and payload, if all fragments of the datagram have been added
    std::optional<Datagram> add(const IpPacket& packet, std::uint64_t offset, std::int64_t stamp_ns) {
        const std::string_view payload = packet.payload;
        Datagram datagram{packet.from, offset, stamp_ns, std::string(payload)};
        if (packet.offset == 0 && !packet.has_more) return datagram;
        if (packet.offset + payload.size() > kMostDatagram) return std::nullopt;
        std::erase_if(pending_, [&](const auto& keyed) {
            return std::abs(stamp_ns - keyed.second.datagram.stamp_ns) > kTogether_ns;
        });
        if (!pending_.contains(packet.key) && pending_.size() >= kMostPending) erase_oldest();
        Pending& pending = pending_[packet.key];
        if (pending.parts.empty()) pending.datagram = {packet.from, offset, stamp_ns, {}};
        std::string& bytes = pending.datagram.bytes;
        bytes.resize(std::max(bytes.size(), packet.offset + payload.size()));
        std::copy(payload.begin(), payload.end(), bytes.begin() + std::ptrdiff_t(packet.offset));
        std::size_t& end = pending.parts[packet.offset];
        end = std::max(end, packet.offset + payload.size());
        if (!packet.has_more) pending.total = packet.offset + payload.size();
        if (!pending.is_complete()) return std::nullopt;
        datagram = std::move(pending.datagram);
        pending_.erase(packet.key);
        return datagram;
    }

private:
    struct Pending {
        std::map<std::size_t, std::size_t> parts;  ///< end of each received fragment, by its byte offset
        std::size_t total = 0;  ///< size of the datagram; known when the last fragment has been received
        Datagram datagram;

        bool is_complete() const {
            std::size_t received = 0;
            for (const auto& [offset, end] : parts)
                if (offset <= received) received = std::max(received, end);
            return total > 0 && received == total;
        }
    };
    std::map<std::string, Pending> pending_;

    void erase_oldest() {
        pending_.erase(std::ranges::min_element(pending_, {},
                                                [](const auto& keyed) { return keyed.second.datagram.at; }));
    }
};

struct ClosePcap {
    void operator()(pcap_t* pcap) const { pcap_close(pcap); }
};

class PcapFile : public BagFile {
public:
    explicit PcapFile(const std::filesystem::path& path) : path_(path) {
        char why[PCAP_ERRBUF_SIZE] = "";
        const UnpackedFile unpacked = open_unpacked(path);
        fseeko(unpacked.file, 0, SEEK_END);
        bytes_ = std::uint64_t(std::max<off_t>(ftello(unpacked.file), 0));
        std::rewind(unpacked.file);
        pcap_.reset(pcap_fopen_offline_with_tstamp_precision(unpacked.file, PCAP_TSTAMP_PRECISION_NANO, why));
        if (!pcap_) std::fclose(unpacked.file);
        if (!unpacked.problem.empty())
            problem_ =
                fmt::format("{}: {}: the packets behind it are missing", path.string(), unpacked.problem);
        if (!pcap_)
            throw DataError(
                fmt::format("{}: cannot read the capture ({}), expected packets in the format "
                            "pcap or pcapng",
                            path.string(), make_excerpt(why)));
        link_ = pcap_datalink(pcap_.get());
        const std::vector<int> known = {DLT_EN10MB, DLT_LINUX_SLL, DLT_LINUX_SLL2, DLT_NULL,
                                        DLT_LOOP,   DLT_RAW,       DLT_IPV4};
        if (std::ranges::find(known, link_) == known.end())
            throw DataError(
                fmt::format("{}: found packets of link type {}, expected Ethernet, Linux cooked or raw IP",
                            path.string(), link_));
        begin_ = position();
    }

    void for_each_message(TopicTable& topics, const Pass& pass) override {
        const std::lock_guard guard(lock_);
        std::vector<std::string> broken;
        ousters_ = packets::find_ouster_metadata(get_unpacked_name(path_), broken);
        if (!problem_.empty()) pass.note(problem_);
        for (const std::string& text : broken) pass.note(text);
        streams_.clear();
        seek(begin_);
        n_cut_ = 0;
        Fragments fragments;
        while (const auto datagram = next(fragments, &pass)) {
            Stream* stream = find_stream(*datagram, topics);
            if (!stream) continue;
            pass.done(bytes_ > 0 ? double(datagram->at) / double(bytes_) : 0.0);
            if (is_after_pause(*stream, stream->n, datagram->stamp_ns - stream->log_ns)) flush(*stream, pass);
            if (stream->n++ == 0) stream->begin_run(*datagram);
            stream->at = std::min(stream->at, datagram->at);
            if (stream->product) append_datagram(stream->run, *datagram);
            if (!stream->product && stream->n_of_bytes.size() < kMostPending)
                ++stream->n_of_bytes[payload(*datagram).size()];
            if (!stream->product ||
                is_message_complete(*stream, stream->n, datagram->stamp_ns - stream->log_ns))
                flush(*stream, pass);
        }
        for (auto& [key, stream] : streams_)
            if (stream.n > 0) flush(stream, pass);
        if (broken.empty() || !ousters_.empty()) note_undecoded_ouster_packets(pass);
        if (n_cut_ > 0)
            pass.note(fmt::format("{}: {} packets were truncated during the capture; their data is missing",
                                  path_.string(), n_cut_));
    }

    SharedBytes read(const Place& place) const override {
        const std::lock_guard guard(lock_);
        const auto stream = std::ranges::find_if(
            streams_, [&](const auto& keyed) { return keyed.second.number == place.in_chunk; });
        if (stream == streams_.end())
            throw DataError(
                "the capture has changed: one of its packet streams "
                "is missing");
        seek(place.at);
        Fragments fragments;
        std::string run;
        const auto late = stream->second.late_runs.find(place.at);
        const std::uint64_t first_at = late == stream->second.late_runs.end() ? place.at : late->second;
        std::int64_t first_ns = 0;
        for (std::size_t n = 0; const auto datagram = next(fragments, nullptr);) {
            if (key_of(*datagram) != stream->first || (n == 0 && datagram->at != first_at)) continue;
            if (is_after_pause(stream->second, n, datagram->stamp_ns - first_ns)) break;
            if (n++ == 0) first_ns = datagram->stamp_ns;
            append_datagram(run, *datagram);
            if (is_message_complete(stream->second, n, datagram->stamp_ns - first_ns)) break;
        }
        return share_bytes(make_message(stream->second, std::move(run)));
    }

private:
    /// What distinguishes the streams of a capture: sender and destination port, LiDAR
    /// product, and metadata of an Ouster. The product is null for other datagrams.
    using Key = std::tuple<std::string, const packets::Product*, const packets::OusterFormat*>;
    struct Stream {
        std::size_t topic = 0;
        std::uint64_t number = 0;
        const packets::Product* product = nullptr;
        std::string run;
        std::size_t n = 0;
        /// Byte offsets in the file of the first frame of the current message, and of its
        /// first datagram. They differ if fragments of several datagrams are interleaved.
        std::uint64_t at = 0, first_at = 0;
        std::int64_t log_ns = 0;
        /// Maps the byte offset of a message to the offset of its first datagram, if the
        /// two differ.
        std::map<std::uint64_t, std::uint64_t> late_runs;
        /// Histogram of datagram sizes in bytes, for streams of unknown products.
        std::map<std::size_t, std::size_t> n_of_bytes;
        std::shared_ptr<const packets::OusterFormat> ouster;  ///< metadata of the sensor
        std::string livox_frame;  ///< frame name of the clouds of a Livox; empty for other products

        void begin_run(const Datagram& datagram) {
            at = first_at = datagram.at;
            log_ns = datagram.stamp_ns;
        }
    };
    packets::OusterFormats ousters_;  ///< metadata from files in the folder of the capture
    const std::filesystem::path path_;
    std::uint64_t bytes_ = 0;
    std::string problem_;  ///< note about a truncated gzip file; may be empty
    std::unique_ptr<pcap_t, ClosePcap> pcap_;
    int link_ = 0;
    std::uint64_t begin_ = 0;
    std::map<Key, Stream> streams_;
    mutable std::size_t n_cut_ = 0;
    mutable std::mutex lock_;  ///< protects the read position in the file

    static std::string_view payload(const Datagram& datagram) {
        return std::string_view(datagram.bytes).substr(8);
    }
    static void append_datagram(std::string& run, const Datagram& datagram) {
        append(run, datagram.stamp_ns);
        append(run, std::uint32_t(datagram.bytes.size() - 8));
        run.append(payload(datagram));
    }
    std::uint64_t position() const {
        return std::uint64_t(std::max<off_t>(ftello(pcap_file(pcap_.get())), 0));
    }
    void seek(std::uint64_t offset) const {
        if (fseeko(pcap_file(pcap_.get()), off_t(offset), SEEK_SET) != 0)
            throw DataError(fmt::format("{}: cannot go to byte {} of the file", path_.string(), offset));
    }

    /// Reads the next UDP datagram of the file, with its UDP header.
    /// @param pass  receives a note if the file is truncated
    std::optional<Datagram> next(Fragments& fragments, const Pass* pass) const {
        for (;;) {
            const std::uint64_t at = position();
            pcap_pkthdr* head = nullptr;
            const unsigned char* data = nullptr;
            const int code = pcap_next_ex(pcap_.get(), &head, &data);
            if (code == PCAP_ERROR && pass)
                pass->note(fmt::format("{}: {}; the packets after byte {} are missing", path_.string(),
                                       make_excerpt(pcap_geterr(pcap_.get())), at));
            if (code != 1) return std::nullopt;
            if (head->caplen < head->len) {
                ++n_cut_;
                continue;
            }
            constexpr std::int64_t kLatest_s = 4'000'000'000;  // later times are damaged
            if (std::int64_t(head->ts.tv_sec) < 0 || std::int64_t(head->ts.tv_sec) > kLatest_s) continue;
            const std::string_view frame(reinterpret_cast<const char*>(data), head->caplen);
            // libpcap was opened with nanosecond precision, so tv_usec contains
            // nanoseconds
            const std::int64_t stamp_ns = std::int64_t(head->ts.tv_sec) * 1000000000 + head->ts.tv_usec;
            const std::optional<IpPacket> packet = parse_ip_packet(frame, link_);
            if (!packet) continue;
            auto datagram = fragments.add(*packet, at, stamp_ns);
            if (!datagram || datagram->bytes.size() < 8) continue;
            const unsigned length = read_big_endian(datagram->bytes, 4);
            if (length < 8 || length > datagram->bytes.size()) continue;
            datagram->bytes.resize(length);
            datagram->source += fmt::format(":{}", read_big_endian(datagram->bytes, 2));
            return datagram;
        }
    }

    std::shared_ptr<const packets::OusterFormat> find_ouster_format(const Datagram& datagram) const {
        return packets::match_ouster_format(ousters_, datagram.source, payload(datagram));
    }
    Key key_of(const Datagram& datagram) const {
        const auto ouster = find_ouster_format(datagram);
        return {datagram.source, packets::find_product(payload(datagram), {{}, ouster}), ouster.get()};
    }

    /// Adds notes for the user about packets that look like Ouster packets by their size
    /// but cannot be decoded. Also adds a note if two senders match the same metadata.
    void note_undecoded_ouster_packets(const Pass& pass) const {
        std::map<const packets::OusterFormat*, std::string> senders;
        for (const auto& [key, stream] : streams_) {
            for (const auto& [size, n] : stream.n_of_bytes) {
                // copy, because clang 14 cannot capture a structured binding in a lambda
                const std::size_t bytes = size;
                const bool is_told = std::ranges::any_of(
                    ousters_, [&](const auto& format) { return format->packet_bytes == bytes; });
                if (n > 1 && (is_told || packets::is_ouster_packet_size(bytes)))
                    pass.note(fmt::format(
                        "{}: {}", path_.string(),
                        packets::describe_ouster_packet(ousters_, path_, std::get<0>(key), bytes)));
            }
            if (!stream.ouster) continue;
            std::string& first = senders[stream.ouster.get()];
            if (!first.empty())
                pass.note(
                    fmt::format("{}: packets of {} and of {} use the same sensor metadata, {}, expected "
                                "one metadata file for each sensor",
                                path_.string(), first, std::get<0>(key), stream.ouster->where));
            first = std::get<0>(key);
        }
    }

    Stream* find_stream(const Datagram& datagram, TopicTable& topics) {
        Key key = key_of(datagram);
        if (const auto known = streams_.find(key); known != streams_.end()) return &known->second;
        if (streams_.size() >= kMostStreams) return nullptr;
        Stream stream;
        stream.number = streams_.size();
        stream.product = std::get<1>(key);
        if (stream.product) stream.ouster = find_ouster_format(datagram);
        if (packets::is_livox(payload(datagram))) stream.livox_frame = datagram.source;
        std::string name = datagram.source;
        // If two Ousters use the same address and port, the serial number distinguishes
        // them.
        for (const auto& [other, known] : streams_)
            if (stream.ouster && known.ouster && std::get<0>(other) == datagram.source)
                name = fmt::format("{} ({})", datagram.source, stream.ouster->serial);
        stream.topic = topics.number_of(
            stream.livox_frame.empty()
                ? Topic{std::move(name), stream.product ? packets::kDatagrams : packets::kOtherDatagrams,
                        packets::kDatagrams}
                : Topic{std::move(name), packets::kLivoxType, packets::kLivoxEncoding});
        return &streams_.emplace(std::move(key), std::move(stream)).first->second;
    }

    /// Returns true if no more datagrams fit into the current message of a stream.
    /// @param count  number of datagrams in the message
    /// @param passed_ns  time from the first to the last datagram of the message
    static bool is_message_complete(const Stream& stream, std::size_t count, std::int64_t passed_ns) {
        return stream.livox_frame.empty()
                   ? count == kRun
                   : passed_ns >= packets::kLivoxCloud_ns || count == packets::kMostLivoxPackets;
    }
    /// Returns true if the sensor paused before a datagram, so that the datagram begins a
    /// new message. Only for Livox sensors.
    /// @param count  number of datagrams in the message so far
    /// @param passed_ns  time from the first datagram of the message to this datagram
    static bool is_after_pause(const Stream& stream, std::size_t count, std::int64_t passed_ns) {
        return count > 0 && !stream.livox_frame.empty() && passed_ns >= 2 * packets::kLivoxCloud_ns;
    }
    /// Encodes datagrams as one message of the stream's topic.
    static std::string make_message(const Stream& stream, std::string run) {
        return stream.livox_frame.empty() ? run : packets::decode_livox_cloud(run, stream.livox_frame);
    }

    void flush(Stream& stream, const Pass& pass) const {
        if (stream.at != stream.first_at) stream.late_runs[stream.at] = stream.first_at;
        pass.take(
            {stream.topic, stream.log_ns, make_message(stream, stream.run), {stream.at, stream.number}});
        stream.run.clear();
        stream.n = 0;
    }
};

}  // namespace

std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file) {
    return std::make_unique<PcapFile>(file);
}

}  // namespace relidar::bag
