// Checks that stay in release builds: each failure is printed, and the process then exits with 1.
#pragma once

#include <cstdio>
#include <stdexcept>
#include <string>

inline int& failures() {
    static int count = 0;
    return count;
}

#define CHECK(condition)                                                                 \
    do {                                                                                 \
        if (!(condition)) {                                                              \
            std::fprintf(stderr, "%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
            ++failures();                                                                \
        }                                                                                \
    } while (false)

inline int report() { return failures() == 0 ? 0 : 1; }

// What a call throws as std::invalid_argument; empty where it does not.
template <class F>
std::string complaint(F&& f) {
    try {
        f();
    } catch (const std::invalid_argument& error) {
        return error.what();
    }
    return "";
}
