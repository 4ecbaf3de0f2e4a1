// Checks that stay in release builds: each failure is printed, and the process then exits with 1.
#pragma once

#include <cstdio>

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
