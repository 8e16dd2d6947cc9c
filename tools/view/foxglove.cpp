// SPDX-License-Identifier: Apache-2.0
#include "foxglove.hpp"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "base/fail.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;

constexpr char kMessageData = 1, kTime = 2;  // first bytes of binary messages
constexpr int kErrorLevel = 2;
constexpr std::size_t kMaxTexts = 16;

template <class T>
void append_number(std::string& bytes, T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string encode_time(std::uint64_t time_ns) {
    std::string bytes(1, kTime);
    append_number(bytes, time_ns);
    return bytes;
}

std::string encode_message(std::uint32_t subscription_id, const ScanMessage& message) {
    std::string bytes(1, kMessageData);
    append_number(bytes, subscription_id);
    append_number(bytes, message.time_ns);
    return bytes + message.bytes;
}

std::string error_status(const std::string& text) {
    const Json status{{"op", "status"}, {"level", kErrorLevel}, {"message", text}};
    return status.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// Returns the message "advertise" of the protocol, which describes the topics. The id of
/// a channel is the index of its topic.
std::string advertise_json(const std::vector<ScanTopic>& topics) {
    Json channels = Json::array();
    for (const ScanTopic& topic : topics)
        channels.push_back({{"id", channels.size()},
                            {"topic", topic.name},
                            {"encoding", "protobuf"},
                            {"schemaName", topic.type},
                            {"schema", topic.schema_base64},
                            {"schemaEncoding", "protobuf"}});
    return Json{{"op", "advertise"}, {"channels", channels}}.dump();
}

const Json& required_list(const Json& message, const char* member) {
    const auto list = message.find(member);
    if (list == message.end() || !list->is_array())
        fail<UsageError>("cannot read the message: expected a list in the field \"{}\"", member);
    return *list;
}

std::uint32_t read_uint32(const Json& value, const char* where) {
    if (!value.is_number_unsigned() || value.get<std::uint64_t>() > std::numeric_limits<std::uint32_t>::max())
        fail<UsageError>(
            "cannot read the message: expected an integer from 0 to 2^32 - 1 in the field \"{}\"", where);
    return value.get<std::uint32_t>();
}

std::uint32_t required_uint32(const Json& object, const char* name) {
    const auto member = object.find(name);
    return read_uint32(member == object.end() ? Json() : *member, name);
}

}  // namespace

/// Prepares the playback of the log's first LiDAR, without any device memory.
FoxglovePlayer::FoxglovePlayer(const Run& run, Device& device, FoxgloveSendCallbacks answers)
    : run_(run),
      device_(device),
      answers_(std::move(answers)),
      sensor_(make_sensor(run.config, run.log)),
      format_(default_options(run, sensor_)),
      topics_(ScanMessageEncoder({format_}).list_topics()) {
    for (const Frame& frame : run.log.frames)
        if (frame.lidar == sensor_.lidar) times_s_.push_back(frame.time_s);
}

void FoxglovePlayer::add_client(ClientId id) {
    const Json info{{"op", "serverInfo"}, {"name", "relidar"}, {"capabilities", Json::array({"time"})}};
    const std::lock_guard lock(mutex_);
    clients_[id].texts = {info.dump(), advertise_json(topics_)};
}

void FoxglovePlayer::remove_client(ClientId id) {
    const std::lock_guard lock(mutex_);
    clients_.erase(id);
}

/// Handles a text from a client, and queues an error for invalid texts.
/// @return false if add_client() was not called for this client: it is another WebSocket
bool FoxglovePlayer::handle_message(ClientId id, const std::string& message) {
    const std::lock_guard lock(mutex_);
    const auto client = clients_.find(id);
    if (client == clients_.end()) return false;
    try {
        handle_operation(client->second, message);
    } catch (const UsageError& error) {
        if (client->second.texts.size() < kMaxTexts)
            client->second.texts.push_back(error_status(error.what()));
    }
    return true;
}

/// Handles the messages "subscribe" and "unsubscribe". A client chooses the number of
/// each subscription (`id`) and names the topic by its index (`channelId`).
/// @throws UsageError if the message is invalid
void FoxglovePlayer::handle_operation(Client& client, const std::string& text) const {
    const Json message = Json::parse(text, nullptr, false);
    if (!message.is_object()) throw UsageError("cannot read the message: expected a JSON object");
    // A reference, because copying deeply nested JSON of a client overflows the stack.
    static const Json kNoOperation;
    const auto field = message.find("op");
    const Json& operation = field == message.end() ? kNoOperation : *field;
    if (operation == "subscribe") {
        for (const Json& request : required_list(message, "subscriptions"))
            add_subscription(client, required_uint32(request, "id"), required_uint32(request, "channelId"));
    } else if (operation == "unsubscribe") {
        for (const Json& id : required_list(message, "subscriptionIds"))
            client.subscriptions.erase(read_uint32(id, "subscriptionIds"));
    } else {
        throw UsageError(
            "cannot read the message: expected \"subscribe\" or \"unsubscribe\" in the field \"op\"");
    }
}

/// Adds a subscription. Its id must be new, and a client has one subscription per topic.
void FoxglovePlayer::add_subscription(Client& client, std::uint32_t id, std::uint32_t topic) const {
    if (topic >= topics_.size())
        fail<UsageError>("cannot subscribe: found channelId {}, expected a number from 0 to {}", topic,
                         topics_.size() - 1);
    const bool has_topic = std::ranges::any_of(
        client.subscriptions, [&](const auto& subscription) { return subscription.second == topic; });
    if (client.subscriptions.contains(id) || has_topic)
        fail<UsageError>(
            "cannot add subscription {} to channel {}: one of them is already in use; unsubscribe first", id,
            topic);
    client.subscriptions.emplace(id, topic);
}

/// Sends all queued texts. Returns true if any client has subscriptions.
bool FoxglovePlayer::flush_texts() {
    const std::lock_guard lock(mutex_);
    bool has_subscriptions = false;
    for (auto& [id, client] : clients_) {
        if (!client.subscriptions.empty()) has_subscriptions = true;
        for (std::string& text : std::exchange(client.texts, {})) answers_.text(id, std::move(text));
    }
    return has_subscriptions;
}

/// Sends the queued texts, and the next scan if its time has come.
std::chrono::milliseconds FoxglovePlayer::send_due(std::chrono::milliseconds max_wait) {
    const bool has_subscriptions = flush_texts();
    if (!has_subscriptions || times_s_.empty()) {
        playback_.reset();  // Frees the renderer and its device memory.
        return max_wait;
    }
    try {
        if (!playback_) playback_.emplace(device_, run_, format_);
        if (Clock::now() >= playback_->due) send_next();
    } catch (const DeviceLost&) {
        throw;
    } catch (const Error& error) {
        // After such an error, for example exhausted device memory, the page still works.
        playback_.reset();
        const std::lock_guard lock(mutex_);
        for (auto& [id, client] : clients_) {
            client.subscriptions.clear();
            client.texts.push_back(error_status(error.what()));
        }
        return max_wait;
    }
    const auto pause = std::chrono::ceil<std::chrono::milliseconds>(playback_->due - Clock::now());
    return std::clamp(pause, std::chrono::milliseconds(0), max_wait);
}

/// Renders and sends one scan, and computes when the next one should be sent. If the
/// device is slow, the playback becomes slower instead of skipping scans.
void FoxglovePlayer::send_next() {
    std::size_t& frame = playback_->frame;
    const double time_s = times_s_[frame];
    const RenderedScan scan = playback_->renderer.render(sensor_, time_s);
    publish(playback_->messages.encode({&scan, 1}));
    frame = (frame + 1) % times_s_.size();
    // The log starts again. A new encoder is needed, because the times of its messages
    // must not decrease.
    if (frame == 0) playback_->messages = ScanMessageEncoder({format_});
    const double period_s = run_.log.lidars[std::size_t(sensor_.lidar)].sweep_period_s();
    const std::chrono::duration<double> interval(frame > 0 ? times_s_[frame] - time_s : period_s);
    playback_->due =
        std::max(Clock::now(), playback_->due + std::chrono::duration_cast<Clock::duration>(interval));
}

/// Sends a scan to each client, with a message for each of its subscriptions.
void FoxglovePlayer::publish(const std::vector<ScanMessage>& messages_per_topic) {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, client] : clients_) {
        if (client.subscriptions.empty()) continue;
        // Sends the time first, because a client that sees the time decrease removes the
        // messages of the previous loop.
        std::vector<std::string> packets{encode_time(messages_per_topic.back().time_ns)};
        for (const ScanMessage& message : messages_per_topic)
            for (const auto& [subscription, topic] : client.subscriptions)
                if (topic == message.topic) packets.push_back(encode_message(subscription, message));
        answers_.scan(id, std::move(packets));
    }
}

}  // namespace relidar::view
