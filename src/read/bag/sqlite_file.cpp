// SPDX-License-Identifier: Apache-2.0
// Reads rosbag2 databases in SQLite. One table contains the topics. Another table
// contains the messages: recording time and bytes.
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include <fmt/ranges.h>
#include <sqlite3.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/bag_file.hpp"
#include "read/bag/part_file.hpp"

namespace relidar::bag {
namespace {

struct CloseDatabase {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
};
struct FinishStatement {
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Statement = std::unique_ptr<sqlite3_stmt, FinishStatement>;

std::string text_column(sqlite3_stmt* statement, int column) {
    const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement, column));
    return text ? std::string(text, std::size_t(sqlite3_column_bytes(statement, column))) : std::string();
}

std::string_view bytes_column(sqlite3_stmt* statement, int column) {
    const auto* bytes = static_cast<const char*>(sqlite3_column_blob(statement, column));
    return bytes ? std::string_view(bytes, std::size_t(sqlite3_column_bytes(statement, column)))
                 : std::string_view();
}

/// A rosbag2 database.
class SqliteFile : public BagFile {
public:
    explicit SqliteFile(const std::filesystem::path& path)
        : name_(path.string()), bytes_(RandomAccessFile(path).size()) {
        std::error_code failed;
        // The last messages can be in a write-ahead log "...-wal", which SQLite ignores
        // in immutable mode.
        const bool is_open = std::filesystem::exists(path.string() + "-wal", failed);
        // Escapes the characters that have a special meaning in a URI.
        std::string uri = "file:";
        for (const char c : std::filesystem::absolute(path).string()) {
            if (c == '?' || c == '#' || c == '%')
                uri += fmt::format("%{:02X}", static_cast<unsigned char>(c));
            else uri += c;
        }
        uri += is_open ? "?mode=ro" : "?mode=ro&immutable=1";
        sqlite3* database = nullptr;
        const int code = sqlite3_open_v2(
            uri.c_str(), &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_URI | SQLITE_OPEN_NOMUTEX, nullptr);
        database_.reset(database);
        if (code != SQLITE_OK) fail_with("opening the database");
        // Damaged sizes: no value can be larger than the file. 1 MiB is a margin.
        sqlite3_limit(database, SQLITE_LIMIT_LENGTH,
                      int(std::min<std::uint64_t>(bytes_ + (1 << 20), 1 << 30)));
        // A bag of a stranger must not run functions with side effects.
        sqlite3_db_config(database, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
        sqlite3_db_config(database, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    }

    void read_messages(TopicTable& topics, const ReadCallbacks& callbacks) override {
        const std::lock_guard guard(lock_);
        std::map<std::int64_t, std::size_t> topic_of;
        const Statement topic_rows = prepare("SELECT id, name, type, serialization_format FROM topics");
        while (next_row(topic_rows.get()))
            topic_of[sqlite3_column_int64(topic_rows.get(), 0)] =
                topics.topic_index({text_column(topic_rows.get(), 1), text_column(topic_rows.get(), 2),
                                    text_column(topic_rows.get(), 3)});
        const std::int64_t last = last_row_id();
        // SQLite reads the bytes of each message that the query returns.
        std::vector<std::int64_t> requested;
        for (const auto& [id, topic] : topic_of)
            if (callbacks.topic_filter(topics.topics()[topic])) requested.push_back(id);
        const Statement rows =
            prepare(fmt::format("SELECT rowid, topic_id, timestamp, CASE WHEN topic_id IN ({}) THEN data END "
                                "FROM messages ORDER BY rowid",
                                fmt::join(requested, ",")));
        while (next_row(rows.get(), &callbacks)) {
            const std::int64_t row = sqlite3_column_int64(rows.get(), 0);
            const auto topic = topic_of.find(sqlite3_column_int64(rows.get(), 1));
            if (topic == topic_of.end())
                fail("{}: the message in row {} belongs to a topic that the file does not list", name_, row);
            callbacks.done(last > 0 ? double(row) / double(last) : 0.0);
            const std::int64_t log_ns = sqlite3_column_int64(rows.get(), 2);
            callbacks.message_callback(
                {topic->second, log_ns, bytes_column(rows.get(), 3), {std::uint64_t(row)}});
        }
    }

    SharedBytes read_message(const MessagePosition& place) const override {
        const std::lock_guard guard(lock_);
        if (!query_of_message_) query_of_message_ = prepare("SELECT data FROM messages WHERE rowid = ?");
        sqlite3_reset(query_of_message_.get());
        sqlite3_bind_int64(query_of_message_.get(), 1, std::int64_t(place.at));
        if (!next_row(query_of_message_.get()))
            fail("{}: row {} of the table 'messages' has disappeared since the file was opened", name_,
                 place.at);
        return share_bytes(std::string(bytes_column(query_of_message_.get(), 0)));
    }

private:
    const std::string name_;
    const std::uint64_t bytes_;
    std::unique_ptr<sqlite3, CloseDatabase> database_;
    mutable std::mutex lock_;             ///< only one thread may use the database at a time
    mutable Statement query_of_message_;  ///< reads one message; prepared once for all messages

    [[noreturn]] void fail_with(const char* action) const {
        fail("{}: {} failed: {}; expected messages of rosbag2 in SQLite", name_, action,
             quote(database_ ? sqlite3_errmsg(database_.get()) : "not enough memory"));
    }

    /// Compiles a query.
    Statement prepare(const std::string& sql_text) const {
        sqlite3_stmt* statement = nullptr;
        if (sqlite3_prepare_v2(database_.get(), sql_text.c_str(), -1, &statement, nullptr) != SQLITE_OK)
            fail_with("reading the list of tables");
        return Statement(statement);
    }

    /// Reads the next row of a query. If the file is damaged and `callbacks` are given,
    /// ends the query with a note. Messages before the damage remain usable.
    bool next_row(sqlite3_stmt* statement, const ReadCallbacks* callbacks = nullptr) const {
        const int code = sqlite3_step(statement);
        if (callbacks && (code == SQLITE_CORRUPT || (code & 0xFF) == SQLITE_IOERR))
            callbacks->note(
                fmt::format("{}: the file is damaged or truncated ({}); later messages are missing", name_,
                            sqlite3_errmsg(database_.get())));
        else if (code != SQLITE_ROW && code != SQLITE_DONE) fail_with("reading the list of messages");
        return code == SQLITE_ROW;
    }

    std::int64_t last_row_id() const {
        const Statement row = prepare("SELECT max(rowid) FROM messages");
        return next_row(row.get()) ? sqlite3_column_int64(row.get(), 0) : 0;
    }
};

}  // namespace

std::unique_ptr<BagFile> open_sqlite_bag(const std::filesystem::path& file) {
    return std::make_unique<SqliteFile>(file);
}

}  // namespace relidar::bag
