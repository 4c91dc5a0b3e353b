/* Replays the record of the export on this board and compares every output with the library's.
 * Needs about @flash@ KB of flash. */
#include <@prefix@_observer.h>

#include "check.h"

void setup() {
    check_result r;
    Serial.begin(115200);
    while (!Serial) {
    }
    check_replay(&r);
    Serial.print(r.rows - r.wrong);
    Serial.print(" of ");
    Serial.print(r.rows);
    Serial.print(" rows as expected, ");
    Serial.print(r.valid);
    Serial.println(" with a valid position");
    if (r.damaged || r.valid == 0) {
        Serial.println("FAILED: the record is not the one that was written");
    } else if (r.wrong == 0 && !r.between) {
        Serial.println("Every output is equal bit for bit.");
    } else if (r.flux_error < 1e-4 && r.angle_error < 1e-3) {
        Serial.println("Equal within rounding: this compiler fuses multiplications and additions.");
    } else {
        Serial.println("FAILED: the outputs are not the library's");
    }
}

void loop() {}
