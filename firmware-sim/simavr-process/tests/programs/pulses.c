/*
 * 1500 us on OC1A, 2000 us on OC1B, every 20 ms. A byte received sets 1000 us on
 * OC1B, at once.
 */
#include "uart.h"

int main(void)
{
	uart_begin();
	OCR1A = 2999;
	OCR1B = 3999;
	DDRB = 1 << 1 | 1 << 2;
	TCCR1A = 1 << COM1A1 | 1 << COM1B1 | 1 << WGM11;
	TCCR1B = 1 << WGM13 | 1 << WGM12;
	/* Only in a mode that has its top there. */
	ICR1 = 39999;
	TCNT1 = 39999;
	TCCR1B = 1 << WGM13 | 1 << WGM12 | 1 << CS11;
	for (;;) {
		uart_receive();
		OCR1B = 1999;
	}
}
