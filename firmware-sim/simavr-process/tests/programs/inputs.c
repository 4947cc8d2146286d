/* Answers each byte with the edges counted, the ADC's counts and the switch. */
#include "uart.h"

static volatile uint8_t edges;

ISR(INT0_vect)
{
	edges++;
}

int main(void)
{
	uart_begin();
	EICRA = 1 << ISC01 | 1 << ISC00;
	EIMSK = 1 << INT0;
	PORTD = 1 << 4;
	ADMUX = 1 << REFS0;
	ADCSRA = 1 << ADEN | 7;
	sei();
	for (;;) {
		uart_receive();
		ADCSRA |= 1 << ADSC;
		while (ADCSRA & 1 << ADSC)
			;
		uint16_t counts = ADC;
		uart_send(edges);
		uart_send(counts);
		uart_send(counts >> 8);
		uart_send(PIND & 1 << 4);
	}
}
