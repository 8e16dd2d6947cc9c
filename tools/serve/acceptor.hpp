// SPDX-License-Identifier: Apache-2.0
// Accepts network connections and passes them to gRPC. gRPC 1.51 could accept connections
// itself, but it stops permanently when no file descriptor is free.
#pragma once

#include <functional>
#include <string>
#include <thread>
#include <vector>

namespace relidar::serve {

class Acceptor {
public:
    /// Must close the file descriptor. Runs on the thread of the acceptor.
    using ConnectionCallback = std::function<void(int listener, int connection)>;

    /// @param address HOST:PORT; port 0 selects a free port
    /// @throws UsageError if the address is invalid or not available
    explicit Acceptor(const std::string& address);
    ~Acceptor();

    int port() const { return port_; }
    /// If too few file descriptors are free, closes new connections immediately.
    void start_accepting(ConnectionCallback handle_connection);
    void stop();

private:
    std::vector<int> listeners_;
    int wake_[2] = {-1, -1};  ///< Pipe that stop() uses to wake the thread that waits for connections.
    int port_ = 0;
    ConnectionCallback receive_;
    std::thread thread_;

    void close_listeners();
    void run_accept_loop();
    void accept_one(int listening_socket);
};

}  // namespace relidar::serve
